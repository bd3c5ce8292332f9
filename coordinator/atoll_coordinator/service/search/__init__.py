"""The search of one equation, as the coordinator follows it. Pure.

``archipelago`` is its whole state: reports, placement, checkpoints. ``collector`` merges reports epoch by epoch and
decides when the search ends, ``cut`` is that end. ``checkpoints`` has what is stored of a checkpoint, how its states
are gathered and when the next one is due; ``checkpoint_coordinator`` limits how many states are pulled at a time.

Report -> `Archipelago.add_report` -> `Collector.add_reports` -> `SearchState`, in the end `Cut`.
States -> `CheckpointCoordinator.add_states` -> `Gathering` -> `Checkpoint` -> (durable) `Archipelago.mark_durable`.
"""
