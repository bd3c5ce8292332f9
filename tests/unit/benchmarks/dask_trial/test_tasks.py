"""The tasks of the trial are functions of their arguments, and what travels for them is told from plain data."""

import pickle
from collections import Counter
from pathlib import PurePosixPath

from benchmarks.dask_trial import tasks
from benchmarks.dask_trial.relay import pickled_calls


def test_batches_hold_every_system_once() -> None:
    batches = tasks.batches(1)
    counts = Counter(system for batch in batches for system in batch.systems)
    assert {*counts.values()} == {1}
    assert {len(batch.systems) for batch in batches[:-1]} == {tasks.BATCH}


def test_equal_batches_give_equal_digests_and_others_do_not() -> None:
    preparation = tasks.prepared(tasks.table_of(1))
    first, second, *_ = tasks.batches(1)
    assert tasks.fitted(preparation, first) == tasks.fitted(tasks.prepared(tasks.table_of(1)), first)
    assert tasks.fitted(preparation, first) != tasks.fitted(preparation, second)
    assert tasks.together(["a", "b"]) != tasks.together(["b", "a"])


def test_calls_of_pickles_are_found_among_other_bytes() -> None:
    data = b"\x80\x05not one" + pickle.dumps(PurePosixPath("a"), protocol=5) + b"rest" + pickle.dumps(print, protocol=5)
    assert pickled_calls(data)[-1] == "builtins.print"
    assert any(name.endswith(".PurePosixPath") for name in pickled_calls(data))
    assert pickled_calls(b"\x80\x05" + pickle.dumps([1, "two"], protocol=5)) == []
