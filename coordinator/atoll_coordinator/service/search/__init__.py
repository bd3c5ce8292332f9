"""The search of one equation, as the coordinator follows it. Pure.

`archipelago` has the whole state of a search: reports, placement, checkpoints. `collector` merges reports epoch by
epoch. `ending` has the conditions that end a search, and the cut, its stored end. `checkpoint_schedule` decides when
checkpoints are taken, gathers their states and has their stored form. `pull_budget` limits how many states are pulled
at a time.

Report -> `Archipelago.add_report` -> `Collector.add_reports` -> `SearchState`, and at the end `Cut`.
States -> `PullBudget.add_states` -> `Gathering` -> `Checkpoint` -> (durable) `Archipelago.mark_durable`.
"""
