"""What is worth trying after a run, by what came of it."""

import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest

from atoll.cli.local_run import program_of
from atoll.cli.next_step import next_step
from atoll.cli.options.parser import parse
from atoll_coordinator.result.result import Result

WORDS = ["run", "my data.csv", "--seed", "3", "--out", "here"]
ENDED_BY_EPOCHS = {"why": "max-epochs", "config": {"budget": {"max_epochs": 20}}}
ENDED_BY_TIME = {"why": "max-time", "config": {"budget": {"max_time": 60.0}}}
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
                f"{AGAIN} --max-time 120s  # the time was over before the equations were fitted",
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


def test_a_budget_that_was_given_is_replaced() -> None:
    words = ["run", "a.csv", "--max-epochs", "20", "--id=old"]
    advice = after("doubtful", **ENDED_BY_EPOCHS, words=words)  # type: ignore[arg-type]
    assert advice is not None
    assert advice.startswith("coordinator run a.csv --max-epochs 40  #")
    advice = after(
        "doubtful", why="max-time", config={"budget": {"max_time": 58.6}}, words=["run", "a", "--max-time", "1m"]
    )
    assert advice is not None
    assert advice.startswith("coordinator run a --max-time 120s  #")


@pytest.mark.parametrize("changes", [{"state": "cancelled"}, {"state": "failed"}, {"equations": []}])
def test_nothing_is_proposed_where_there_is_no_outcome(changes: dict[str, Any]) -> None:
    assert after(**changes) is None


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


@pytest.mark.parametrize(
    ("path", "is_found", "called"),
    [
        ("/lab/.venv/bin/coordinator", False, ".venv/bin/coordinator"),
        (".venv/bin/coordinator", False, ".venv/bin/coordinator"),
        ("/opt/bin/coordinator", False, "/opt/bin/coordinator"),
        ("/lab/.venv/bin/coordinator", True, "coordinator"),
        ("/lab/atoll/__main__.py", False, "coordinator"),
    ],
)
def test_the_program_is_called_as_it_is_found_from_here(path, is_found, called, monkeypatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}" if is_found else None)
    assert program_of(Path(path), Path("/lab")) == called
