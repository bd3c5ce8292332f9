"""One function for each command; it takes the parsed options and returns the exit code.

``run`` searches on this machine; ``serve`` and ``router`` run until they are told to end; ``submit`` gives a job to a
coordinator and follows it; ``jobs`` has the verbs that ask a coordinator (``ping``, ``jobs``, ``status``, ``workers``,
``cancel``, ``delete``, ``logs``); ``result`` prints equations; ``models`` has the verbs that take the model of a saved
result (``simulate``, ``analyse``, ``suggest``, ``export``), ``report`` writes its page.
`options.parser.HANDLERS` maps commands to these modules; ``doctor`` has a room of its own.
"""
