"""A folder of cases: what is read of it, and which verdicts are right."""

import json
from pathlib import Path

import numpy as np
import pytest

from atoll_core.errors import DataError, UsageError
from benchmarks.verdicts.cases import Case, CaseOutcome, cases_of, columns_of, judged, row

COLUMNS = {"t": np.arange(20.0), "x": np.linspace(3.0, 1.0, 20)}


def equation(text: str, verdict: str) -> dict[str, object]:
    return {"equations": [{"variable": "x", "expression": text, "verdict": verdict, "reason": "r"}]}


@pytest.mark.parametrize(
    ("text", "verdict", "form", "is_allowed"),
    [
        ("-0.4*x", "good", "right", True),
        ("-0.4*x", "exact", "right", False),
        ("-0.4*x**2", "good", "other", False),
        ("-0.4*x**2", "doubtful", "other", True),
    ],
)
def test_a_verdict_is_right_where_it_is_listed_and_what_is_relied_on_is_the_truth(
    text: str, verdict: str, form: str, is_allowed: bool
) -> None:
    case = Case("a.csv", "", {"x": "-0.5*x"}, ("good", "doubtful"))
    (shown,) = judged(case, COLUMNS, equation(text, verdict))
    assert (shown.form, shown.is_allowed) == (form, is_allowed)


def test_a_truth_whose_equation_is_missing_is_not_found() -> None:
    case = Case("a.csv", "", {"x": "-0.5*x", "y": "-y"}, ("good",))
    shown = judged(case, COLUMNS, equation("-0.4*x", "good"))
    assert [(one.variable, one.form, one.is_allowed) for one in shown] == [("x", "right", True), ("y", "none", False)]
    assert CaseOutcome("a.csv", "done", "", shown, 1.0).found == "no"


def test_without_verdicts_and_truth_any_result_is_right_but_there_must_be_one() -> None:
    shown = judged(Case("a.csv"), COLUMNS, equation("x**9", "good"))
    done, refused = (CaseOutcome("a.csv", end, "", those, 1.0) for end, those in (("done", shown), ("refused", ())))
    assert (done.is_allowed, done.found, refused.is_allowed) == (True, "-", False)
    assert row(refused) == ("a.csv", "refused", "NO", "-", "1.0")


def test_the_list_of_a_folder_is_read(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--data"):
        cases_of(tmp_path)
    listed = [{"file": "a.csv", "options": "--order 2", "truth": None, "verdicts": ["good"], "seen": "", "right": ""}]
    (tmp_path / "cases.json").write_text(json.dumps(listed), "utf-8")
    (case,) = cases_of(tmp_path)
    assert (case.name, case.verdicts) == ("a.csv --order 2", ("good",))
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n2,nan\n3,5\n4,6\n5,6\n", "utf-8")
    assert columns_of(case, tmp_path)["x"].tolist() == [1.0, 2.0, 5.0, 6.0, 6.0]
    assert "x_dot" in columns_of(case, tmp_path)
    (tmp_path / "cases.json").write_text("[{}]", "utf-8")
    with pytest.raises(DataError, match="no list of cases"):
        cases_of(tmp_path)
