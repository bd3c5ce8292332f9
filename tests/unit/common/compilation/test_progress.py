"""The bar of compiling kernels moves with time, and the remaining time is true where the costs are."""

import threading

import pytest

from atoll_core.compilation.progress import RemainingTime, WarmUpDisplay, count_of, reporting, sentence_of, share_of

COSTS = (1.0, 2.0, 5.0, 2.0)


class Clock:
    """A clock that is set by hand, in seconds."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.mark.parametrize("pace", [1.0, 3.0])
def test_the_remaining_time_is_true_on_a_machine_of_any_speed(pace: float) -> None:
    clock = Clock()
    estimate = RemainingTime(COSTS, clock)
    for number, cost in enumerate(COSTS[:-1], start=1):
        clock.now += pace * cost
        estimate.add()
        left = pace * sum(COSTS[number:])
        assert estimate.sentence() == sentence_of(number, 4, left, pace * sum(COSTS))
        assert share_of(estimate.sentence()) == pytest.approx(sum(COSTS[:number]) / sum(COSTS))


def test_the_bar_moves_during_a_kernel_and_never_past_the_kernels_after_it() -> None:
    clock = Clock()
    estimate = RemainingTime(COSTS, clock)
    clock.now += 1.0
    estimate.add()
    shares = []
    for _ in range(30):
        shares.append(share_of(estimate.sentence()))
        clock.now += 0.25
    assert shares == sorted(shares)
    assert shares[0] == pytest.approx(0.1)
    assert shares[-1] == pytest.approx(0.3), "the second kernel takes longer than it usually does"


def test_before_the_first_kernel_the_usual_time_is_told() -> None:
    assert RemainingTime(COSTS, Clock()).sentence().endswith("0 of 4 compiled, 10 s of 10 s left")


@pytest.mark.parametrize(
    ("sentence", "count", "share"),
    [
        ("waiting while another process compiles", None, None),
        (sentence_of(1, 4), (1, 4), 0.25),
        (sentence_of(1, 4, 30.0, 40.0), (1, 4), 0.25),
        (sentence_of(4, 4), (4, 4), 1.0),
    ],
)
def test_counts_and_shares_are_read_from_messages(
    sentence: str, count: tuple[int, int] | None, share: float | None
) -> None:
    assert (count_of(sentence), share_of(sentence)) == (count, share)


def test_while_one_kernel_is_compiled_reports_go_on() -> None:
    said: list[str] = []
    enough = threading.Event()

    def report(sentence: str) -> None:
        said.append(sentence)
        if len(said) == 5:
            enough.set()

    with reporting(COSTS, [], report, interval=0.001):
        assert enough.wait(30.0)
    assert {count_of(sentence) for sentence in said[:-1]} == {(0, 4)}
    assert said[-1] == sentence_of(4, 4)


def test_without_a_terminal_the_first_and_the_last_count_are_written_once(capsys: pytest.CaptureFixture[str]) -> None:
    show = WarmUpDisplay()
    for sentence in (sentence_of(0, 4, 10.0, 10.0), sentence_of(0, 4, 9.0, 10.0), sentence_of(2, 4), sentence_of(4, 4)):
        show(sentence)
    show("the kernels of the wheel cannot be used")
    assert capsys.readouterr().err.splitlines() == [
        sentence_of(0, 4, 10.0, 10.0), sentence_of(4, 4), "the kernels of the wheel cannot be used",
    ]  # fmt: skip
