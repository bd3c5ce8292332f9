"""What ``coordinator run`` starts on this machine.

``workers`` starts and ends the worker processes, ``coordinator`` runs router and service in a thread, and ``local_run``
does what the user asked for, by a client like any other: `verbs.run` -> `LocalWorkers` (started first) -> `LocalRun` ->
`LocalCoordinator`, then `request.Request.submit` and `terminal.follow.Follower`.
"""
