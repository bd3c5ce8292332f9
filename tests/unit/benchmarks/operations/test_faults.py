"""Real faults: what strikes is drawn from a seed, and what is said of it is what happened."""

import pytest

from atoll_core.wire.messages.views import JobState, JobView, VariableView
from benchmarks.operations.faults import main
from benchmarks.operations.strikes import LASTING_S, Standing, Strikes


def view(state: JobState = "running", **epochs: int) -> JobView:
    variables = tuple(
        VariableView(variable=name, lhs=name, epoch=epoch, point_evaluations=0, finished=epoch == 9, why=None)
        for name, epoch in epochs.items()
    )
    return JobView(
        job="j", name="", state=state, seed=0, preset="default", reason=None, warnings=(), submitted="", elapsed=0.0,
        workers=1, point_evaluations=0, variables=variables,
    )  # fmt: skip


def test_strikes_are_drawn_from_their_seed() -> None:
    def drawn(seed: int) -> list[object]:
        strikes = Strikes(seed, tuple(LASTING_S), ("w0", "w1"))
        return [strikes.next() for _ in range(200)]

    assert drawn(1) == drawn(1) != drawn(2)
    assert {strike.kind for strike in drawn(1)} == set(LASTING_S)  # type: ignore[attr-defined]
    for strike in Strikes(0, ("stop-worker",), ("w0",)).next(), Strikes(0, ("kill-coordinator",), ("w0",)).next():
        low, high = LASTING_S[strike.kind]
        assert low <= strike.for_s <= high
    assert Strikes(0, ("kill-coordinator",), ("w0",)).next().who == "coordinator"


def test_a_search_has_recovered_when_every_equation_got_further_or_is_over() -> None:
    before = Standing.of(view(x=3, y=5))
    assert not before.is_passed_by(Standing.of(view(x=4, y=5)))
    assert before.is_passed_by(Standing.of(view(x=4, y=6)))
    assert before.is_passed_by(Standing.of(view(x=4, y=9)))
    assert before.is_passed_by(Standing.of(view("done", x=3, y=5)))
    assert not before.is_passed_by(Standing.of(view()))


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--kinds", "kill-time"], "'kill-time' was given"),
        (["--kinds", "kill-router"], "with --own-router only"),
        (["--kinds", "cut-worker"], "with --networks only"),
    ],
)
def test_what_cannot_be_struck_is_refused(words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert sentence in capsys.readouterr().err
