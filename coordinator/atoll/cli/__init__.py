"""The command line ``coordinator``.

``main`` parses, calls a verb and turns errors into exit codes; ``options`` holds the parser; ``verbs`` has a function
for each command, ``doctor`` those that examine a machine, ``adapt`` what starts and ends workers by the queue.
``request`` is a job as the user asked for it, ``local_run`` one on this machine, ``exit_codes`` what its end means,
``result_files`` what is written of it, ``next_step`` what is proposed then, ``worker_table`` a list of workers,
``listener`` where others connect to.

`main.main` -> `options.parser.parse` -> `verbs.submit.submit` -> `request.Request` -> `atoll.client.client.Client`
-> (bus) -> `atoll_coordinator.service.requests`. Of a run on this machine: `verbs.run` -> `LocalWorkers` (started
first) -> `run_locally` -> `LocalCoordinator`, then `Request.submit` and `Follower`. Each verb's module is imported when
it is called, since ``--help`` must be instant.
"""
