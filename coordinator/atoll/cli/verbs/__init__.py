"""One function for each command; it takes the parsed options and returns the exit code.

``run`` searches on this machine; ``serve`` and ``router`` run until they are told to end; ``submit`` gives a job to a
coordinator and follows it; ``ping``, ``workers`` and ``logs`` ask a coordinator, ``jobs`` has the verbs about its jobs
(``jobs``, ``status``, ``cancel``, ``delete``); ``result`` prints equations; ``models`` has the verbs that take the
model of a saved result (``simulate``, ``analyse``, ``suggest``, ``export``), ``report`` writes its page.
`options.parser.HANDLERS` maps commands to these modules; ``doctor`` has a room of its own.
"""
