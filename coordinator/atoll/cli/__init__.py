"""The command line ``coordinator``.

``main`` parses the words, calls a verb and turns errors into exit codes. ``options`` has the table of verbs and the
parser. ``verbs`` has the functions of the verbs; ``doctor`` and ``adapt`` are verbs of their own size. ``request`` is a
job as the user described it, ``result_files`` the files written of it, ``exit_codes`` the meaning of a job's end.

The path of a command: `main.main` -> `options.parse` -> `verbs.submit.submit` -> `request.Request` ->
`atoll.client.client.Client` -> (bus) -> `atoll_coordinator.service.requests`. For a run on this machine: `verbs.run`
starts `LocalWorkers` first, then `verbs.submit.run_locally` starts `LocalCoordinator`, submits and follows. The module
of a verb is imported when the verb is called, because ``--help`` must be instant.
"""
