"""What a result says of how far its model can be trusted: alternatives, verdicts, correlations, simulations.

Plain dictionaries, lists, texts and numbers for ``result.json``; a number that is not known or not finite is null.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from atoll_coordinator.data.recording import Preparation, Recording, Source
from atoll_coordinator.model.inference.verdict import Evidence, judge
from atoll_coordinator.model.refinement import (
    Alternative,
    Chaos,
    Correlation,
    Covariance,
    GroupCovariance,
    Prediction,
    Refined,
    Simulated,
    Simulation,
)
from atoll_coordinator.model.result.numbers import curve, finite, thinned
from atoll_core.data.dataset import Dataset, FloatArray, Target
from atoll_core.expression.text.infix import PRINTABLE_SIZE, to_infix, tree_size
from atoll_core.wire.messages.views import FINAL_STATES, JobState

MOST_POINTS: Final = 200
"""Points of one simulated trajectory in a result; a longer one is thinned evenly."""
MOST_NUMBERS: Final = 100_000
"""Numbers of all curves together, about 1 MB as text."""
LEAST_POINTS: Final = 2
MOST_CANDIDATES: Final = 20


def verdict(
    shown: Refined | None, target: Target, state: JobState, *, has_trajectories: bool, is_known: bool = False
) -> dict[str, Any]:
    """Return grade and reason of an equation; null while the job has not ended.

    Where refining did not judge it, its error on the target decides. Where there are trajectories, it is doubtful at
    best then: it could not be simulated along them, or there was no time.
    """
    if state not in FINAL_STATES:
        return {"verdict": None, "reason": None}
    if shown is None:
        return {"verdict": "no model", "reason": "The search has found no equation."}
    grade, reason = (
        (shown.grade, shown.reason)
        if shown.grade is not None
        else judge(replace(_on_target(shown, target, is_known), is_unsimulated=has_trajectories))
    )
    if shown.units is not None and shown.units.faults and grade in ("exact", "good"):
        return {"verdict": "doubtful", "reason": f"Units contradict it: {shown.units.faults[0]}."}
    return {"verdict": grade, "reason": reason}


def _on_target(shown: Refined, target: Target, is_known: bool) -> Evidence:
    error = shown.error / target.standard_deviation if target.standard_deviation else math.inf
    variance = target.standard_deviation * target.standard_deviation
    r2 = 1.0 - shown.mse / variance if variance else math.nan
    return Evidence(
        error,
        target.uncertainty,
        finite(r2),
        constants=shown.constants,
        is_known=is_known,
        convergence_threshold=target.convergence_threshold(),
    )


def prediction(its: Prediction | None) -> dict[str, Any] | None:
    """Return how far a state can be foretold from other initial states in the measured box; None: not known."""
    if its is None:
        return None
    return {
        "starts": its.starts,
        "followed": its.followed,
        "unfinished": its.unfinished,
        "probability": finite(its.probability),
        "novelty": finite(its.novelty),
        "reached": finite(its.reached),
        "is_disputed": its.is_disputed,
        "measure_from": dict(its.measure_from) if its.measure_from else None,
    }


def chaos(its: Chaos | None) -> dict[str, Any] | None:
    """Return what is known of a model whose courses cannot be foretold for long; None where they can be, or unknown."""
    if its is None:
        return None
    return {
        "lyapunov_time": its.lyapunov_time,
        "is_kept": its.is_kept,
        "is_unfinished": its.is_unfinished,
        "probability": finite(its.probability),
    }


def candidates(alternatives: Sequence[Alternative], dataset: Dataset) -> list[dict[str, Any]]:
    """Return the equations that were compared with the one shown, itself first, then the best."""
    printable = [each for each in alternatives if tree_size(each.program) <= PRINTABLE_SIZE]
    ordered = sorted(printable, key=lambda each: (not each.is_shown, each.nats))
    return [
        {
            "expression": to_infix(each.program, dataset.names),
            "complexity": len(each.program),
            "nats": finite(each.nats),
            "r2": finite(each.r2),
            "held_out_r2": finite(each.held_out_r2),
            "cross_validated": each.is_cross_validated,
            "origin": each.origin,
            "selected": each.is_shown,
        }
        for each in ordered[:MOST_CANDIDATES]
    ]


def correlations(pairs: Sequence[Correlation]) -> list[dict[str, Any]]:
    """Return pairs of constants that the data hardly tell apart; ``constant`` counts an equation's ``constants``."""
    return [
        {
            "first": {"variable": pair.first[0], "constant": pair.first[1]},
            "second": {"variable": pair.second[0], "constant": pair.second[1]},
            "value": finite(pair.value),
        }
        for pair in pairs
    ]


def covariance(its: Covariance | None) -> dict[str, Any] | None:
    """Return the joint covariance of all constants; ``constant`` counts an equation's ``constants``.

    It is null for a factor of one that is not written; these come in the order of the equation's ``implied``.
    """
    if its is None:
        return None
    return {
        "constants": [{"variable": variable, "constant": number} for variable, number in its.constants],
        "matrix": [[finite(value) for value in row] for row in its.matrix.tolist()],
        "freedom": finite(its.freedom),
    }


def groups(recording: Recording | None, known: Sequence[GroupCovariance]) -> list[dict[str, Any]]:
    """Return the groups of trajectories that may differ in constants, with the covariance of those of each."""
    if recording is None:
        return []
    found = {its.group: its.covariance for its in known}
    return [
        {
            "group": name,
            "trajectories": [each.name for each in recording.trajectories if each.group == name],
            "covariance": covariance(found.get(name)),
        }
        for name in recording.groups
    ]


def simulation(its: Simulation | None, given: Preparation) -> dict[str, Any] | None:
    """Return the simulated trajectories, thinned, at the times of the user's file; None when there are none."""
    if its is None:
        return None
    recording = given.recording
    offset = recording.offset if recording is not None else 0.0
    numbers = len(its.trajectories) * (1 + 4 * len(its.states))
    names = _with_velocities(its.states, given.source)
    most = max(LEAST_POINTS, min(MOST_POINTS, MOST_NUMBERS // max(numbers, 1)))
    return {"trajectories": [_trajectory(each, its, offset, most, names) for each in its.trajectories]}


def _with_velocities(states: Sequence[str], source: Source | None) -> tuple[str, ...]:
    """Return the states, and for order 2 their velocities behind them: what an initial state consists of."""
    if source is None or not source.velocities:
        return tuple(states)
    return (*states, *(source.velocities[source.states.index(name)] for name in states))


def _trajectory(its: Simulated, of: Simulation, offset: float, most: int, names: Sequence[str]) -> dict[str, Any]:
    rows = thinned(len(its.times), most)
    return {
        "name": its.name,
        "held_out": its.held_out,
        "r2": dict(zip(of.states, map(finite, its.r2), strict=True)),
        "offsets": {state: finite(value) for state, value in its.offsets.items()},
        "start": None
        if its.start is None
        else {name: finite(value) for name, value in zip(names, its.start.tolist(), strict=False)},
        "times": curve(its.times[rows] + offset, digits=12),
        "measured": _curves(its.measured, of.states, rows),
        "values": _curves(its.values, of.states, rows),
        "lower": _curves(_beside(its, -of.quantile), of.states, rows),
        "upper": _curves(_beside(its, of.quantile), of.states, rows),
    }


def _beside(its: Simulated, errors: float) -> FloatArray | None:
    if its.values is None or its.errors is None:
        return None
    with np.errstate(all="ignore"):
        return np.asarray(its.values + errors * its.errors)


def _curves(values: FloatArray | None, states: Sequence[str], rows: list[int]) -> dict[str, Any] | None:
    if values is None:
        return None
    return {state: curve(its[rows]) for state, its in zip(states, values, strict=True)}
