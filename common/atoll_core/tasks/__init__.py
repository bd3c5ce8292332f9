"""What a worker and its task process say to each other.

``frames`` are the values that pass between them, ``installation`` says whether both are of the same version. The
process itself is `atoll.tasks`; the worker that starts it, `atoll_island_worker.tasks`. What coordinator
and workers say of tasks is in `atoll_core.wire.messages.tasks`.
"""
