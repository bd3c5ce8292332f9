"""Making all kernels of the coordinator ready before work comes: compiled once per machine, else loaded."""

from atoll_coordinator.data.differentiation.warmup import warm_up as warm_up_data
from atoll_coordinator.model.shooting.warmup import warm_up as warm_up_trajectories


def warm_up() -> None:
    """Compile or load every kernel of data preparation and of trajectory fits; some 15 seconds the first time."""
    warm_up_data()
    warm_up_trajectories()
