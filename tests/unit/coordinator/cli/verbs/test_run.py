"""How many workers a local run starts."""

from typing import Any

import pytest

from atoll_coordinator.cli.options.parser import parse
from atoll_coordinator.cli.verbs import run as module


class Started(Exception):
    """Ends a run when its workers would be started."""


@pytest.mark.parametrize(("options", "number"), [([], 1), (["--workers", "3"], 3)])
def test_workers_are_as_many_as_the_cores_that_may_be_used(
    options: list[str], number: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    def workers(endpoint: str, number: int, log: Any) -> None:
        raise Started(number)

    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "1")
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(8)))
    monkeypatch.setattr(module, "LocalWorkers", workers)
    with pytest.raises(Started) as started:
        module.run(parse(["run", "data.csv", "--out", str(tmp_path / "out"), *options]))
    assert started.value.args == (number,)
