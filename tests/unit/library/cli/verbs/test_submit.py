"""``coordinator submit``: whoever leaves while a job is on its way is told its id."""

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from atoll.cli.parser import parse
from atoll.cli.request import JobRequest, request_of
from atoll.cli.result_files import refuse_existing_result, write_result
from atoll.cli.verbs.submit import next_step
from atoll_coordinator.result.result import Result
from atoll_core.config import BudgetConfig, JobConfig
from atoll_core.errors import UsageError


@pytest.mark.parametrize(("gone", "left"), [(1.0, 9.0), (4.0, 6.0), (9.0, 5.0)])
def test_what_starting_took_counts_for_the_time_up_to_half_of_it(gone, left):
    request = JobRequest("job", "name", JobConfig(budget=BudgetConfig(max_time=10.0)), (Path("a.csv"),), json=False)
    assert request.after(gone).config.budget.max_time == left


def test_a_sheet_of_what_is_no_workbook_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    with pytest.raises(UsageError) as raised:
        request_of(parse(["run", str(tmp_path / "a.csv"), "--sheet", "run 1"]))
    assert raised.value.on_command_line.startswith("--sheet names a sheet of an Excel workbook, but a.csv is not a")
    (tmp_path / "a.XLSX").write_text("")
    request = request_of(parse(["run", str(tmp_path / "a.csv"), str(tmp_path / "a.XLSX"), "--sheet", "run 1"]))
    assert request.config.data.sheet == "run 1"


def test_a_result_is_written_once_and_never_over_another(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    path = write_result(folder, Result(job="one", equations=(), symbols={"θ": "θ"}))
    with pytest.raises(UsageError, match="exists already"):
        write_result(folder, Result(job="two", equations=(), symbols={}))
    assert json.loads(path.read_text("utf-8"))["symbols"] == {"θ": "θ"}
    with pytest.raises(UsageError, match="exists already"):
        refuse_existing_result(folder)


WORDS = ["run", "my data.csv", "--seed", "3", "--out", "here"]
ENDED_BY_EPOCHS = {"why": "max-epochs", "config": {"budget": {"max_epochs": 20}}}
SIMULATED = {"simulation": {"trajectories": [{"name": "1"}]}}
AGAIN = "coordinator run 'my data.csv' --seed 3"


def after(
    verdict: str = "good", reason: str = "", why: str = "law", loose: bool = False, rivals: int = 0, **changes: Any
) -> str | None:
    equation = {
        "variable": "x",
        "lhs": "dx/dt",
        "expression": "x",
        "verdict": verdict,
        "reason": reason,
        "why": why,
        "constants": [{"identifiable": True}, {"identifiable": not loose}],
        "candidates": [{"expression": "1", "nats": 0.5}] * rivals,
    }
    words = changes.pop("words", WORDS)
    content = {"schema": 1, "symbols": {"x": "x"}, "state": "done", "equations": [equation], "warnings": []}
    content |= {"system": {"kind": "dynamics", "inputs": []}, "config": {}}
    return next_step(Result.of({**content, **changes}), Path("here"), words)


@pytest.mark.parametrize(
    ("proposed", "outcome"),
    [
        ("coordinator analyse here", {}),
        ("coordinator analyse here", {"rivals": 1}),
        (AGAIN, {"state": "cancelled", "refining": "not refined"}),
        ("coordinator suggest here", {"verdict": "doubtful", "rivals": 1}),
        ("coordinator analyse here --identifiability", {"verdict": "doubtful", "loose": True, "rivals": 1}),
        (
            "coordinator simulate here -o here/simulation.csv",
            {"system": {"kind": "process", "inputs": []}, **SIMULATED},
        ),
        (
            "coordinator simulate here -o here/simulation.csv",
            {"system": {"kind": "dynamics", "inputs": ["u"]}, **SIMULATED},
        ),
        ("coordinator analyse here", {"system": {"kind": "dynamics", "inputs": ["u"]}, "simulation": None}),
        ("coordinator result here/result.json --format latex", {"system": {"kind": "regression", "inputs": ["u"]}}),
        (f"{AGAIN} --robust", {"warnings": ["Some look like outliers; --robust takes their weight away."]}),
        (f"{AGAIN} --missing-value -9999", {"warnings": ["6 rows hold -9999 in 'y'; add --missing-value -9999."]}),
        (f"{AGAIN} --order 2", {"verdict": "doubtful", "warnings": ["'x' turns; to do so, add --order 2."]}),
        ("coordinator analyse here", {"warnings": ["'x' turns; to do so, add --order 2."]}),
        (f"{AGAIN} --hold 'u 1,w'", {"verdict": "doubtful", "warnings": ["If so, add --hold 'u 1,w', since it is."]}),
        (f"{AGAIN} --per-trajectory", {"verdict": "doubtful", "warnings": ["to let them, add --per-trajectory."]}),
        (f"{AGAIN} --stochastic", {"reason": "It grows like a random walk: with --stochastic, drift and diffusion"}),
        (f"{AGAIN} --operators '+,-,*,/,sin,cos,exp,sqrt,tanh'", {"verdict": "no model"}),
        ("coordinator result here/result.json", {"verdict": "no model", "config": {"space": {"max_size": 9}}}),
        (
            f"{AGAIN} --max-epochs 40",
            {"verdict": "doubtful", "why": "max-epochs", "config": {"budget": {"max_epochs": 20}}},
        ),
        (
            f"{AGAIN} --max-time 120s",
            {"verdict": "no model", "why": "max-time", "config": {"budget": {"max_time": 60.0}}},
        ),
        *(
            (
                f"{AGAIN} --max-time 120s  # the time limit ended the job before equations were fitted",
                {"verdict": "doubtful", "refining": end, "config": {"budget": {"max_time": 60.0}}},
            )
            for end in ("not refined", "max-time")
        ),
        ("coordinator analyse here", {"refining": "max-time", "config": {"budget": {"max_time": 60.0}}}),
        ("coordinator analyse here", ENDED_BY_EPOCHS),
        (
            "coordinator analyse here",
            {"warnings": ["with --stochastic, drift"], "config": {"data": {"weights": "w"}}},
        ),
    ],
)
def test_the_command_suits_the_outcome(proposed: str, outcome: dict[str, Any]) -> None:
    advice = after(**outcome)
    assert advice is not None
    assert advice.startswith(f"{proposed}  #" if "#" not in proposed else proposed)


def test_what_is_proposed_can_be_said() -> None:

    for outcome in (
        {},
        {"verdict": "no model"},
        {"system": {"kind": "process"}},
        {"verdict": "doubtful", "loose": True},
    ):
        advice = after(**outcome)  # type: ignore[arg-type]
        assert advice is not None
        assert parse(shlex.split(advice.partition("  # ")[0])[1:]).verb


def test_after_doubtful_hidden_states_experiments_are_not_proposed() -> None:
    text = after("doubtful", rivals=1, hidden=["x"]) or ""
    assert text.startswith("coordinator analyse here --identifiability")
