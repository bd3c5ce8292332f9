"""The command line ``coordinator``.

``main`` parses the options, calls a verb and turns errors into exit codes. ``parser`` has the table of verbs and the
parser. ``verbs`` has the functions of most verbs; the larger verbs ``doctor`` and ``adapt`` have their own modules.
``request`` describes the job that the options define, ``result_files`` writes its result to files, and ``exit_codes``
maps the end of a job to an exit code.

The path of a command: `main.main` -> `parser.parse` -> `verbs.submit.submit` -> `request.Request` ->
`atoll.client.client.Client` -> (bus) -> `atoll_coordinator.service.requests`. For a run on this machine: `verbs.run`
starts `LocalWorkers` first, then `verbs.submit.run_locally` starts `LocalCoordinator`, submits and follows. The module
of a verb is imported when the verb is called, because ``--help`` must be instant.
"""
