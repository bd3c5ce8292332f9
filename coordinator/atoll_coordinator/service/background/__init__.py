"""Work that takes long, away from the service's loop.

``runner`` starts it and posts the outcomes to the loop; ``job_tasks`` has the functions that prepare and refine a job;
``process_pool`` runs them in child processes, ``child_process`` is one of these as the coordinator sees it and
``child_main`` the program that runs in it. Checkpoints are written by a thread of this process. ``dependencies``
names all that a test puts in the place of processes, clock and thread.

A submitted job: `runner.TaskRunner.prepare` -> `process_pool.ProcessPool.submit` -> pipe -> `child_main.main` ->
`job_tasks.prepare_job` -> `atoll_coordinator.data.prepare.prepare`; its outcome comes back by the pipe and is posted.
"""
