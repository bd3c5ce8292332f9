"""The command line ``coordinator``.

``main`` parses, calls a verb and turns errors into exit codes; ``options`` holds the parser and makes a job's
configuration; ``verbs`` has a function for each command, ``doctor`` those that examine a machine; ``local`` is what
``run`` starts here; ``request`` is a job as the user asked for it; ``terminal`` follows jobs and prints; ``signals``
handles Ctrl-C and SIGTERM, ``exit_codes`` names what a shell sees.

`main.main` -> `options.parser.parse` -> `verbs.submit.submit` -> `request.Request` -> `atoll.client.Client`
-> (bus) -> `atoll_coordinator.service.requests`. Each verb's module is imported when it is called, since ``--help``
must be instant.
"""
