"""What preparing hands on to refining, from bytes to bytes."""

import json

import pytest

from atoll_coordinator.model import pipeline
from atoll_coordinator.model.pools import Law, Pool
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.result.building import KNOWN, VariableOutcome
from atoll_coordinator.model.selection.shortcut import add_laws
from atoll_coordinator.model.sparse import laws
from atoll_coordinator.result.result import timed
from atoll_coordinator.tasks.preparing import PreparationOutcome, prepare
from atoll_coordinator.tasks.refining import Searched, refine
from atoll_core.config import JobConfig
from atoll_core.errors import DataError, RemoteProtocolError, UsageError
from atoll_core.wire.values import decode_value, encode_value
from tests.unit.coordinator.model.sparse.ring import RING, SUMS, ring

SPECIFICATION = SUMS.model_dump_json().encode()


def outcome() -> PreparationOutcome:
    """Return what preparing gives, as each start of a coordinator has it done."""
    return decode_value(prepare(ring().to_bytes(), SPECIFICATION), PreparationOutcome)


@pytest.mark.slow
def test_laws_among_many_variables_are_sought_once_in_a_job_and_are_the_same_after_a_restart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sought, tasks, find = [], [], laws.find_short_laws
    monkeypatch.setattr(laws, "find_short_laws", lambda equations, spread: sought.extend(equations) or find(equations))
    monkeypatch.setattr(pipeline, "select_model", lambda task: tasks.append(add_laws(task)))
    job, pools = outcome(), Searched("j", tuple(VariableOutcome(name, (), 1) for name in RING)).to_bytes()
    refine(job.encoded, pools, None, pipeline.refine_all)
    assert len(sought) == len(RING)
    assert [bool(tasks[0].laws[name]) for name in RING] == [True] * 5 + [False]
    assert outcome() == job  # to the byte
    pipeline.refine_all(job.prepared.preparation, job.prepared.config, {name: Pool(()) for name in RING})
    assert len(sought) == 3 * len(RING)
    first, again = ([encode_value(law, Law) for name in RING for law in task.laws[name]] for task in tasks)
    assert first == again


@pytest.mark.parametrize("error", [DataError, UsageError, RemoteProtocolError])
def test_data_that_cannot_be_prepared_are_a_sentence_and_no_mistake(error: type[Exception]) -> None:
    def refuses(table: bytes, config: JobConfig) -> None:
        raise error("there are no rows; give some")

    made = decode_value(prepare(b"", SPECIFICATION, refuses), PreparationOutcome)  # type: ignore[arg-type]
    assert (made.is_prepared, made.sentence) == (False, "there are no rows; give some")
    with pytest.raises(RemoteProtocolError):
        _ = made.prepared


def test_a_mistake_of_ours_is_none_of_the_data() -> None:
    def breaks(*_: object) -> None:
        raise ZeroDivisionError("planted")

    with pytest.raises(ZeroDivisionError):
        prepare(b"", SPECIFICATION, breaks)  # type: ignore[arg-type]


def test_refining_gets_the_time_that_is_left_and_what_was_prepared() -> None:
    from tests.simulation.harness.simulated_cluster import prepare as prepare_stub

    job = decode_value(prepare(b"x,y", SPECIFICATION, prepare_stub), PreparationOutcome)
    got: list[object] = []

    def refiner(preparation, config, pools, deadline, laws) -> Refinement:
        got.extend([preparation.dataset.variables, config, pools, deadline.seconds_left, laws])
        return Refinement(warnings=("made",))

    made = refine(
        job.encoded,
        Searched("j", (VariableOutcome("x", (), 1), VariableOutcome("y", (), 1, why=KNOWN))).to_bytes(),
        50.0,
        refiner,
    )
    assert json.loads(timed(made.decode(), 3.5))["warnings"] == ["made"]
    assert json.loads(timed(made.decode(), 3.5))["seconds"] == 3.5
    assert got[:3] == [("x", "y"), job.prepared.config, {"x": Pool(())}]
    assert 0.0 < got[3] <= 50.0
