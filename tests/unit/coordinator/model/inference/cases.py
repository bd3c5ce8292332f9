"""Checks of equations of every kind with quantities that tests give, and the sentences of their verdicts.

``python -m tests.unit.coordinator.model.inference.cases`` writes ``sentences.txt`` anew, after a change of words.
"""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from atoll_coordinator.model.inference.checks import EquationChecks
from atoll_coordinator.model.inference.long_run import LongRun
from atoll_coordinator.model.inference.target_checks import TargetChecks
from atoll_coordinator.model.inference.trajectory_checks import TrajectoryChecks, UnsimulatedChecks
from atoll_coordinator.model.inference.verdict import judge
from atoll_coordinator.model.refinement import Refined, UnitCoefficient
from atoll_core.data.dataset import FloatArray, Target
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.parts import chaos, constant, prediction

SENTENCES = Path(__file__).with_name("sentences.txt")
KNOWN = (constant(3.0, 2.98, 0.02, (2.94, 3.02)), constant(1.0, 1.01, 0.02, (0.97, 1.05)))
SURE = prediction(12, 12, 0.99, measure_from={"x": 1.0, "y": 2.0})


def noise(sd: float, seed: int = 0, rows: int = 100) -> tuple[FloatArray, ...]:
    draw = np.random.default_rng(seed)
    return tuple(draw.normal(0.0, sd, rows) for _ in range(4))


def waves(sd: float) -> tuple[FloatArray, ...]:
    return tuple(sd * np.sqrt(2.0) * np.sin(np.linspace(0.0, 12.0, 100) + start) for start in range(4))


def given(kind: type[EquationChecks], **quantities: Any) -> Any:
    """Return the checks of an equation whose quantities are given and not measured, in a job of this kind."""
    made: Any = object.__new__(kind)
    known = {"constants": (), "unit_coefficients": (), "uncertainty": 0.0, "digits": None, "chaos": None,
             "predictable_rows": None, "is_cross_validated": False, "are_errors_summed": False, "piece": 500,
             "held_inputs": (), "is_near": False, "text": "x", "unsupported_state": "", "unknown_inputs": {},
             "odds_of_alternatives": 0.0,
             "passes_pole": False,
             "is_known": False, "stopped": "", "is_cancelled": False, "target_r2": None, "prediction": None,
             **quantities}  # fmt: skip
    units = tuple(UnitCoefficient(from_infix("x", ("x",)), one) for one in known["unit_coefficients"])
    shown = Refined(0, from_infix(known["text"], ("x",)), 0.0, 0.0, known["constants"], units)
    values = np.array([0.1, 0.3, 0.4, 0.2, 0.9]) if known["digits"] == 1 else np.random.default_rng(0).normal(size=20)
    recording = SimpleNamespace(inputs=known["held_inputs"], input_kinds=["held" for _ in known["held_inputs"]])
    task = SimpleNamespace(piece=known["piece"], recording=recording)
    final = SimpleNamespace(
        task=task,
        are_errors_summed=known["are_errors_summed"],
        held_out_comparison=None if known["is_cross_validated"] else (),
    )
    vars(made).update(
        known, quantities=quantities, shown=shown, target=Target("x", "x", values, known["uncertainty"], 1.0),
        final=final, long_run=LongRun(None, known["chaos"], None, known["predictable_rows"]),
        measurements=SimpleNamespace(has_smoothed_inputs=known["is_near"]),
    )  # fmt: skip
    return made


def replace(made: Any, **quantities: Any) -> Any:
    """Return the same checks with other quantities."""
    return given(type(made), **{**made.quantities, **quantities})


NOISY = given(
    TrajectoryChecks, error=0.3, uncertainty=0.2, target_r2=0.9, residuals=noise(0.1), parameters=3.0, noise=0.1,
    standard_deviation=2.0, constants=KNOWN, alternative=9.0, prediction=SURE, null_nats=500.0, distinct_rows=400,
)  # fmt: skip
SHARP = (constant(3.0, 3.0, 2e-9, (3.0, 3.0)), constant(1.0, 1.0, 2e-9, (1.0, 1.0)))
CLEAN = given(
    TrajectoryChecks, error=1e-12, uncertainty=1e-9, target_r2=1.0, residuals=waves(1e-9), parameters=3.0, noise=0.0,
    standard_deviation=2.0, constants=SHARP, prediction=SURE, null_nats=500.0, distinct_rows=400,
)  # fmt: skip
TARGET = given(
    TargetChecks, error=0.05, target_r2=0.99, predicted_r2=0.99, residuals=noise(0.1), parameters=3.0, noise=0.1,
    standard_deviation=2.0, constants=KNOWN, null_nats=500.0, distinct_rows=400,
)  # fmt: skip
EXACT_TARGET = replace(TARGET, error=3e-14, residuals=noise(1e-14), noise=0.0, constants=SHARP)
UNSIMULATED = given(UnsimulatedChecks, error=0.3, target_r2=0.9, constants=KNOWN)
SOLVER = "solve_ivp, RK45, rtol=0.001, atol=1e-06"

FAILED: dict[str, tuple[dict[str, Any], ...]] = {
    "explained variance": ({"residuals": noise(1.9)}, {"residuals": (np.array([0.1, np.nan, 0.1]),)}),
    "degrees of freedom": ({"parameters": 400.0, "residuals": noise(0.01)},),
    "distinct rows": ({"distinct_rows": 4},),
    "no equation": ({"null_nats": 4.5},),
    "held-out trajectories": ({"held_out_r2": 0.3}, {"held_out_r2": 0.3, "is_cross_validated": True}),
    "residual size": ({"residuals": noise(0.17)}, {"residuals": waves(0.1), "noise": 0.0}),
    "residual pattern": ({"residuals": waves(0.1)},),
    "whole trajectories": ({"fits_whole": False}, {"fits_whole": False, "predictable_rows": 244}),
    "long run": ({"chaos": chaos(2.0, False, 0.001)}, {"chaos": chaos(2.0, False, None)}),
    "other initial states": (
        {"prediction": SURE.replaced(probability=0.7)},
        {"prediction": SURE.replaced(followed=10)},
        {"prediction": prediction(12, 0, 0.0)},
    ),
    "poles": ({"passes_pole": True},),
    "alternative equations": ({"alternative": 1.24}, {"alternative": -1.24}),
    "constants": (
        {"constants": (KNOWN[0], KNOWN[1].replaced(identifiable=False))},
        {"constants": (KNOWN[1].replaced(identifiable=False),)},
        {"constants": (KNOWN[1].replaced(value=0.5, at_bound=True),)},
    ),
}
"""By check, what makes a noisy equation fail it."""
NOT_MADE: dict[str, tuple[dict[str, Any], ...]] = {
    "time": ({"stopped": "the choice of the equations"}, {"stopped": "the choice", "is_cancelled": True}),
    "inputs between rows": (
        {"unknown_inputs": {"u": 0.3, "w 1": 0.2, "v": 0.01}, "held_inputs": ("h",)},
        {"unknown_inputs": {"u": math.nan}},
    ),
    "whole trajectories": ({"fits_whole": None}, {"fits_whole": None, "predictable_rows": 244}),
    "long run": ({"chaos": chaos(2.0, False, None, is_unfinished=True)},),
    "other initial states": (
        {"prediction": None, "unsupported_state": "y"},
        {"prediction": SURE.replaced(followed=9, unfinished=3)},
    ),
    "constants": ({"constants": (), "text": "1.5*x + 2.5*x*x + 3.5*x*x*x"},),
}
"""By check, what keeps it from being made, for noisy equations and others."""
OF_TARGETS: dict[str, tuple[dict[str, Any], ...]] = {
    "good": ({},),
    "doubtful": (
        {"uncertainty": 0.04}, {"predicted_r2": 0.8}, {"predicted_r2": None}, {"residuals": waves(0.1)},
        {"null_nats": -3.0}, {"distinct_rows": 3}, {"parameters": 400.0}, {"stopped": "the choice of the equation"},
        {"residuals": (), "null_nats": None, "distinct_rows": None, "predicted_r2": None},
    ),
    "no model": (
        {"target_r2": 0.02}, {"target_r2": 0.02, "is_known": True}, {"error": math.inf, "target_r2": None},
    ),
}  # fmt: skip
"""By grade, changes of the quantities of a target."""
CRUMB = constant(4.6e-07, 4.6e-07, 4.6e-08, (3.6e-07, 5.6e-07))
OTHERS = (
    NOISY,
    replace(NOISY, held_out_r2=0.995, unknown_inputs={"u": 0.01}),
    replace(NOISY, held_out_r2=0.99996, is_cross_validated=True),
    replace(NOISY, prediction=SURE.replaced(reached=3.51), is_near=True),
    replace(NOISY, chaos=chaos(2.0, True, 0.3), fits_whole=None),
    replace(NOISY, residuals=noise(0.1), is_noise_residual=True, innovations=noise(0.1)),
    replace(NOISY, residuals=noise(0.12, rows=2), distinct_rows=8),
    replace(NOISY, residuals=noise(1.4, rows=3), noise=1.4, parameters=2.0),
    replace(NOISY, residuals=waves(1e-9)),
    UNSIMULATED,
    CLEAN,
    replace(CLEAN, residuals=waves(1e-3)),
    replace(CLEAN, solver=SOLVER),
    replace(CLEAN, solver=SOLVER, residuals=waves(1e-3)),
    replace(CLEAN, are_errors_summed=True, residuals=waves(0.02)),
    replace(CLEAN, residuals=noise(0.02, rows=2), noise_estimate=0.008, parameters=2.0),
    replace(CLEAN, odds_of_alternatives=0.0052),
    replace(CLEAN, odds_of_alternatives=1.0, alternative=0.0),
    replace(CLEAN, constants=(*SHARP, CRUMB)),
    replace(CLEAN, constants=(constant(-1e-12, -1e-12, 1e-9, (-2e-9, 2e-9)),)),
    replace(CLEAN, constants=()),
    EXACT_TARGET,
    replace(EXACT_TARGET, null_nats=5.0),
    replace(EXACT_TARGET, digits=1, constants=(constant(2.53, 2.53, 1e-9, (2.53, 2.53)),)),
)


def sentences() -> str:
    """Return the sentence of each verdict and the reason of each check, each once."""
    of_noisy = [
        replace(NOISY, **change) for some in (FAILED, NOT_MADE) for changes in some.values() for change in changes
    ]
    of_targets = [replace(TARGET, **change) for changes in OF_TARGETS.values() for change in changes]
    verdicts = [judge(checks) for checks in (*OTHERS, *of_noisy, *of_targets)]
    lines = dict.fromkeys(f"{verdict.grade}: {verdict.reason}" for verdict in verdicts)
    reasons: dict[str, None] = {}
    for check in (check for verdict in verdicts for check in verdict.checks):
        reasons.setdefault(f"{check.name}, {check.outcome}: {check.reason}")
    return "\n".join([*lines, "", *sorted(reasons)]) + "\n"


if __name__ == "__main__":
    SENTENCES.write_text(sentences(), "utf-8")
