"""Evidence on equations of every kind, and the sentences of their verdicts.

``python -m tests.unit.coordinator.model.inference.cases`` writes ``sentences.txt`` anew, after a change of words.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from atoll_coordinator.model.inference.verdict import Evidence, judge
from atoll_core.data.dataset import FloatArray
from tests.unit.coordinator.model.parts import chaos, constant, prediction

SENTENCES = Path(__file__).with_name("sentences.txt")
KNOWN = (constant(3.0, 2.98, 0.02, (2.94, 3.02)), constant(1.0, 1.01, 0.02, (0.97, 1.05)))
SURE = prediction(12, 12, 0.99, measure_from={"x": 1.0, "y": 2.0})


def noise(sd: float, seed: int = 0, rows: int = 100) -> tuple[FloatArray, ...]:
    draw = np.random.default_rng(seed)
    return tuple(draw.normal(0.0, sd, rows) for _ in range(4))


def waves(sd: float) -> tuple[FloatArray, ...]:
    return tuple(sd * np.sqrt(2.0) * np.sin(np.linspace(0.0, 12.0, 100) + start) for start in range(4))


NOISY = Evidence(
    error=0.3, target_uncertainty=0.2, target_r2=0.9, residuals=noise(0.1), parameters=3.0, noise=0.1,
    standard_deviation=2.0, constants=KNOWN, alternative=9.0, prediction=SURE, null_nats=500.0, piece=500,
    distinct_rows=400,
)  # fmt: skip
SHARP = (constant(3.0, 3.0, 2e-9, (3.0, 3.0)), constant(1.0, 1.0, 2e-9, (1.0, 1.0)))
CLEAN = Evidence(
    error=1e-12, target_uncertainty=1e-9, target_r2=1.0, residuals=waves(1e-9), parameters=3.0, noise=0.0,
    standard_deviation=2.0, constants=SHARP, prediction=SURE, null_nats=500.0, piece=500,
    distinct_rows=400,
)  # fmt: skip
TARGET = Evidence(
    kind="target", error=0.05, target_r2=0.99, predicted_r2=0.99, residuals=noise(0.1), parameters=3.0, noise=0.1,
    standard_deviation=2.0, constants=KNOWN, null_nats=500.0, distinct_rows=400,
)  # fmt: skip
EXACT_TARGET = replace(TARGET, error=3e-14, residuals=noise(1e-14), noise=0.0, constants=SHARP)
SOLVER = "solve_ivp, RK45, rtol=0.001, atol=1e-06"
UNSIMULATED: dict[str, Any] = {
    "residuals": (), "null_nats": None, "is_unsimulated": True, "distinct_rows": None, "alternative": None
}  # fmt: skip

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
        {"prediction": None, "unpredicted": "for a reason"},
        {"prediction": SURE.replaced(followed=9, unfinished=3)},
    ),
    "constants": ({"unfitted": 6},),
}
"""By check, what keeps it from being made, for noisy equations and others."""
OF_TARGETS: dict[str, tuple[dict[str, Any], ...]] = {
    "good": ({},),
    "doubtful": (
        {"target_uncertainty": 0.04}, {"predicted_r2": 0.8}, {"predicted_r2": None}, {"residuals": waves(0.1)},
        {"null_nats": -3.0}, {"distinct_rows": 3}, {"parameters": 400.0}, {"stopped": "the choice of the equation"},
        {"residuals": (), "null_nats": None, "distinct_rows": None, "predicted_r2": None},
    ),
    "no model": (
        {"target_r2": 0.02}, {"target_r2": 0.02, "is_known": True}, {"error": math.inf, "target_r2": None},
    ),
}  # fmt: skip
"""By grade, changes of a target's evidence."""
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
    replace(NOISY, **UNSIMULATED),
    CLEAN,
    replace(CLEAN, residuals=waves(1e-3)),
    replace(CLEAN, solver=SOLVER),
    replace(CLEAN, solver=SOLVER, residuals=waves(1e-3)),
    replace(CLEAN, are_errors_summed=True, residuals=waves(0.02)),
    replace(CLEAN, residuals=noise(0.02, rows=2), noise_estimate=0.008, parameters=2.0),
    replace(CLEAN, rivals=0.0052, rivals_agree=True),
    replace(CLEAN, rivals=1.0, rivals_agree=True, alternative=0.0),
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
    verdicts = [judge(evidence) for evidence in (*OTHERS, *of_noisy, *of_targets)]
    lines = dict.fromkeys(f"{verdict.grade}: {verdict.reason}" for verdict in verdicts)
    reasons: dict[str, None] = {}
    for check in (check for verdict in verdicts for check in verdict.checks):
        reasons.setdefault(f"{check.name}, {check.outcome}: {check.reason}")
    return "\n".join([*lines, "", *sorted(reasons)]) + "\n"


if __name__ == "__main__":
    SENTENCES.write_text(sentences(), "utf-8")
