"""What people see.

``output`` prints lines, notes, JSON and tables and writes ``result.json``; ``follow`` asks for a job until it ends;
``progress`` shows it, as a table that redraws itself, as plain lines or as JSON; ``workers`` lists workers and the
coordinator's counters; ``next_step`` proposes a command after a run. `follow.Follower` -> client -> `progress.Display`.
"""
