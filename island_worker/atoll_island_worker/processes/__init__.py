"""The processes of several workers on one machine: started, watched, started again, ended.

- ``fork_server``: loads libraries and kernels once, then forks workers; where a fork is not safe they are commands.
- ``supervisor``: polls the children, starts those again that die, passes SIGTERM on, kills who does not end.
- ``restart_policy``: whether a process that has ended is started again, and when (pure).
- ``exit_reasons``: the pipe by which children report why they end; each sentence is printed once.
- ``command``: the command of one worker. ``parent``: the end of a process with its parent.

The life of a worker's process: `atoll_island_worker.launch` hands the supervisor a way to start each worker; a child
that dies reports its reason and its exit code; the policy answers with a pause, after which it is started again, or
with none (it ended in order, was refused, or died five times within a minute). The exit code is the worst of all.
"""
