"""Simulated islands take the place of the compute thread, so they must have all that a worker uses of it."""

import inspect

from atoll_island_worker.compute.compute_thread import ComputeThread
from benchmarks.operations.island_samples import Samples
from benchmarks.operations.simulated_islands import Books, PacedCompute, Pacer


def test_simulated_islands_have_the_interface_of_the_compute_thread() -> None:
    thread, paced = ComputeThread(), PacedCompute(Samples((), 1, 1), 1.0, Pacer(), Books())
    thread.close()
    names = [name for name in dir(thread) if not name.startswith("_")]
    assert [name for name in names if not hasattr(paced, name)] == []
    methods = [name for name in names if inspect.isfunction(getattr(ComputeThread, name, None))]
    for name in methods:
        assert inspect.signature(getattr(paced, name)).parameters.keys() == (
            inspect.signature(getattr(thread, name)).parameters.keys()
        ), name
