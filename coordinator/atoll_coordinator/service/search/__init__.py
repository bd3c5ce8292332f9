"""The search of one equation, as the coordinator follows it. Pure.

`archipelago` has its whole state: reports, placement, checkpoints. `collector` merges reports epoch by epoch, `ending`
says what ends the search and has the cut; `checkpoints` decides when checkpoints are taken, gathers their states and
has their stored form; `pull_budget` limits how many states are pulled at a time.

Report -> `Archipelago.add_report` -> `Collector.add_reports` -> `SearchState`, in the end `Cut`.
States -> `PullBudget.add_states` -> `Gathering` -> `Checkpoint` -> (durable) `Archipelago.mark_durable`.
"""
