"""The search of one equation, as the coordinator follows it. Pure.

``archipelago`` is its whole state: reports, placement, checkpoints. ``collector`` merges reports epoch by epoch,
``ending`` says what ends the search, ``cut`` is where it ended and what was found there. ``checkpoint_gathering`` has
what is stored of a checkpoint and how its states are gathered, ``checkpoint_schedule`` when the next one is due;
``pull_budget`` limits how many states are pulled at a time. The store commits it (`store.checkpoint_table`).

Report -> `Archipelago.add_report` -> `Collector.add_reports` -> `SearchState`, in the end `Cut`.
States -> `PullBudget.add_states` -> `Gathering` -> `Checkpoint` -> (durable) `Archipelago.mark_durable`.
"""
