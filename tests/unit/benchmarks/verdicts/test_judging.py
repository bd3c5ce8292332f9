"""Verdicts of drawn tables: which are false, what a summary counts, and what a limit of time or a rate must not do."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from atoll_core.errors import AtollError
from benchmarks.harness.journal import Journal
from benchmarks.verdicts import few_rows, groups, targets
from benchmarks.verdicts.autonomous import FULL, LIMITED
from benchmarks.verdicts.drawn import Drawn
from benchmarks.verdicts.judging import EquationOutcome, Key, Outcome, judge
from benchmarks.verdicts.tables import by_kind, cases, is_as_promised, limits, line, rates, summary

DECAY = few_rows.draw(9)
DOSES = targets.draw(1)


def shown(drawn: Drawn, verdict: str, **texts: str) -> EquationOutcome:
    rows = [{"variable": name, "expression": text, "verdict": verdict, "reason": "r"} for name, text in texts.items()]
    (equation,) = judge(drawn, {"equations": rows})
    return equation


def outcome(equation: EquationOutcome, key: Key | None = None, **changes: object) -> Outcome:
    given: Mapping[str, object] = {"end": "done", "sentence": "", "seconds": 2.0, **changes}
    return Outcome(key or Key("few-rows", 9), "decay, 1%", 9, equations=(equation,), **given)  # type: ignore[arg-type]


def test_good_is_false_where_neither_form_nor_prediction_is_right() -> None:
    right = shown(DECAY, "good", x="-0.2401*x")
    near = shown(DECAY, "good", x="-0.24*x + 0.001")
    wrong = shown(DECAY, "good", x="-0.1*x - 3.0")
    assert [one.form for one in (right, near)] == ["right", "extra"]
    assert [one.is_false for one in (right, near, wrong)] == [False, False, True]
    assert wrong.r2 is not None
    assert wrong.r2 < 0.9
    assert not shown(DECAY, "doubtful", x="-0.1*x - 3.0").is_false


def test_a_model_that_is_wrong_beyond_what_was_measured_is_counted_apart() -> None:
    text = f"{DOSES.laws['']['y']} + exp(40.0*(x - 5.9))"
    bold = shown(DOSES, "good", y=text)
    assert (bold.is_false, bold.is_wrong_beyond) == (False, True)
    assert not shown(DOSES, "good", y=str(DOSES.laws[""]["y"])).is_wrong_beyond


def test_a_model_that_cannot_be_simulated_foretells_nothing() -> None:
    assert shown(DECAY, "good", x="x**3 + 9.0").r2 == -float("inf")
    missing = judge(DECAY, {"equations": []})
    assert [(one.form, one.grade, one.is_false) for one in missing] == [("none", "no model", False)]


def test_the_form_must_be_right_in_each_group() -> None:
    drawn = groups.draw(1)
    rows = [{"group": group, "expression": laws["x"]} for group, laws in drawn.laws.items()]
    result = {"equations": [{"variable": "x", "expression": "-x", "verdict": "good", "groups": rows}]}
    assert judge(drawn, result)[0].is_right
    rows[-1]["expression"] = "-0.094*x"
    (wrong,) = judge(drawn, result)
    assert (wrong.is_right, wrong.is_false) == (False, True)
    rows[-1]["group"] = "9"
    with pytest.raises(AtollError, match="no group '3'"):
        judge(drawn, result)


def test_a_summary_counts_false_verdicts_and_right_laws_that_are_doubted() -> None:
    doubted, false = shown(DECAY, "doubtful", x="-0.24*x"), shown(DECAY, "good", x="-0.1*x - 3.0")
    outcomes = [outcome(doubted), outcome(false, Key("few-rows", 18), limit=30.0, is_cut=True, numbers=9, values=9)]
    counts = " ".join(summary(outcomes).splitlines()[-1].split())
    assert counts == "few-rows 2 0 0 2 0 0 1 1 1 0 1 1 2 1 1 1 1 0/0 1 2.0, 2"
    assert "decay" in by_kind(outcomes)
    said = "\n".join(cases(outcomes))
    assert "FALSE good: few-rows 18" in said
    assert "DOUBTED: few-rows 9" in said
    assert "FALSE good" in line(outcomes[1])


def test_the_promise_is_broken_by_false_verdicts_and_by_what_broke() -> None:
    good, false = shown(DECAY, "good", x="-0.24*x"), shown(DECAY, "good", x="-0.1*x - 3.0")
    many = [outcome(good, Key("few-rows", seed)) for seed in range(60)]
    assert is_as_promised(many)
    assert is_as_promised([*many, outcome(false)])
    assert not is_as_promised([*many[:40], outcome(false)])
    others = [outcome(good, Key("targets", seed)) for seed in range(60)]
    assert is_as_promised([*many, *others, outcome(false)])
    assert not is_as_promised([*many, *others[:20], outcome(false)])
    assert not is_as_promised([*many, outcome(shown(DECAY, "exact", x="-0.1*x - 3.0"))])
    assert not is_as_promised([outcome(good, end="broke", sentence="s")])


def test_a_limit_of_time_must_not_make_a_verdict_better() -> None:
    def pair(full: EquationOutcome, limited: EquationOutcome) -> list[str]:
        keys = [Key("limits", 2, variant) for variant in (FULL, LIMITED)]
        both = [outcome(full, keys[0]), outcome(limited, keys[1], limit=5.0)]
        return limits(both, lambda key: DECAY)

    doubtful = shown(DECAY, "doubtful", x="-0.24*x - 0.1*x*x")
    assert len(pair(doubtful, shown(DECAY, "good", x="-0.23*x"))) == 1
    assert pair(doubtful, shown(DECAY, "good", x="-0.22*x - 0.2*x**2")) == []
    assert pair(shown(DECAY, "good", x="-0.23*x"), doubtful) == []


def test_a_motion_sampled_faster_has_the_same_model_and_verdict() -> None:
    texts = ("-0.24*x", "-0.2*x", "-0.24*x - 0.1*x*x")
    verdicts = ("good", "doubtful", "doubtful")
    ended = [
        outcome(shown(DECAY, verdict, x=text), Key("rates", 1, factor))
        for text, verdict, factor in zip(texts, verdicts, ("1", "3", "10"), strict=True)
    ]
    first, second = rates(ended, lambda key: DECAY)
    assert first.startswith("OTHER VERDICT: rates 1 1 and 3")
    assert second.startswith("OTHER MODEL: rates 1 3 and 10")


def test_outcomes_are_read_back_from_a_journal(tmp_path: Path) -> None:
    path = tmp_path / "j.jsonl"
    ended = outcome(shown(DECAY, "good", x="x**3 + 9.0"))
    Journal("verdicts", Outcome, path, [], resume=False).add(ended)
    assert Journal("verdicts", Outcome, path, [], resume=True).outcomes == {ended.key: ended}
