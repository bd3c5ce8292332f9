"""Which worker computes which island. Pure and deterministic; it decides about time only, never about bits."""

from collections.abc import Sequence


def spread(islands: int, first: int, workers: Sequence[str]) -> tuple[str, ...]:
    """Return for each island its worker: evenly, in turn over the sorted workers.

    Args:
        islands: how many there are.
        first: islands placed before (of the job's other variables), so that the turn goes on where it stopped and
            variables with fewer islands than workers come to lie on different workers.
        workers: at least one, names unique.
    """
    order = sorted(workers)
    return tuple(order[(first + island) % len(order)] for island in range(islands))
