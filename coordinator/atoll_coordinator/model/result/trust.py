"""What a result says of how far its model can be trusted: alternatives, verdicts, correlations, simulations."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Preparation, Recording, Source
from atoll_coordinator.model import refinement
from atoll_coordinator.model.inference.verdict import Verdict, judge, with_objection
from atoll_coordinator.model.refinement import Alternative, GroupCovariance, JobKind, Refined
from atoll_coordinator.model.result.numbers import curve, finite, thinned
from atoll_coordinator.result.equations import Candidate, Check, Prediction
from atoll_coordinator.result.findings import Chaos, Correlation, Covariance, Group, Place
from atoll_coordinator.result.listed_trajectories import Simulated, Simulation
from atoll_core.data.dataset import Dataset, FloatArray, Problem
from atoll_core.expression.text.infix import PRINTABLE_SIZE, to_infix, tree_size
from atoll_core.wire.messages.views import FINAL_STATES, JobState

MOST_POINTS: Final = 200
"""Points of one simulated trajectory in a result; a longer one is thinned evenly."""
MOST_NUMBERS: Final = 100_000
"""Numbers of all curves together, about 1 MB as text."""
LEAST_POINTS: Final = 2
MOST_CANDIDATES: Final = 20


def verdict(
    shown: Refined | None, problem: Problem, state: JobState, *, has_trajectories: bool, why: str | None = None,
    weights: FloatArray | None = None,
) -> Verdict | None:  # fmt: skip
    """Return the verdict on an equation; None while the job has not ended.

    Where refining did not judge it, its error on the target decides. Where there are trajectories, it is doubtful at
    best then: it could not be simulated along them, or there was no time.

    Args:
        shown: the equation, None where none was found.
        problem: the rows of its search.
        state: of the job.
        has_trajectories: whether equations are to be simulated along trajectories.
        why: why its search ended, "known" where the equation was given.
        weights: (R,) of the rows, None: all alike.
    """
    if state not in FINAL_STATES:
        return None
    if shown is None:
        return Verdict("no model", "The search has found no equation.", ())
    judged = Verdict(shown.grade, shown.reason or "", shown.checks) if shown.grade is not None else None
    if judged is None:
        # loads kernels, which the process that serves needs for such equations alone
        from atoll_coordinator.model.inference.target_evidence import target_evidence

        kind: JobKind = "trajectories" if has_trajectories else "target"
        is_cancelled = why == "cancelled" or state == "cancelled"
        evidence = target_evidence(
            shown, problem, weights, kind=kind, is_known=why == _KNOWN,
            stopped="the choice of the equation" if is_cancelled or why == "max-time" else "",
        )  # fmt: skip
        judged = judge(replace(evidence, is_cancelled=is_cancelled))
    if judged.grade in ("exact", "good") and shown.units is not None and shown.units.faults:
        judged = with_objection(judged, "units", "failed", f"units contradict it: {shown.units.faults[0]}")
    if judged.grade == "good" and why in _STOPPED and not (has_trajectories and why == "max-epochs"):
        judged = with_objection(judged, "search", "not made", _STOPPED[why])
    return judged


_KNOWN: Final = "known"
_STOPPED: Final = {
    "max-time": "the limit of time stopped the search before it converged or stagnated: give more time with --max-time",
    "max-epochs": "the search ended with its last epoch before it converged or stagnated: allow more with --max-epochs",
    "cancelled": "the search was cancelled before it converged or stagnated: let it run on",
}
"""What stops a search before it has looked at all that it would have, by why it ended."""


def checks(made: Sequence[refinement.Check]) -> tuple[Check, ...]:
    """Return the checks of an equation as they are written."""
    return tuple(
        Check(
            name=check.name,
            outcome=check.outcome,
            reason=check.reason,
            value=finite(check.value),
            limit=finite(check.limit),
            power=finite(check.power),
        )
        for check in made
    )


def prediction(known: refinement.Prediction | None) -> Prediction | None:
    """Return how far a state can be foretold from other initial states in the measured box; None: not known."""
    if known is None:
        return None
    return Prediction(
        starts=known.starts,
        followed=known.followed,
        unfinished=known.unfinished,
        probability=finite(known.probability),
        novelty=finite(known.novelty),
        reached=finite(known.reached),
        is_disputed=known.is_disputed,
        measure_from=dict(known.measure_from) if known.measure_from else None,
    )


def chaos(known: refinement.Chaos | None) -> Chaos | None:
    """Return what is known of a model whose courses cannot be foretold for long; None where they can be, or unknown."""
    if known is None:
        return None
    return Chaos(
        lyapunov_time=known.lyapunov_time,
        is_kept=known.is_kept,
        is_unfinished=known.is_unfinished,
        probability=finite(known.probability),
    )


def candidates(alternatives: Sequence[Alternative], dataset: Dataset) -> tuple[Candidate, ...]:
    """Return the equations that were compared with the one shown, itself first, then the best, and all guesses."""
    printable = [alternative for alternative in alternatives if tree_size(alternative.program) <= PRINTABLE_SIZE]
    ordered = sorted(printable, key=lambda alternative: (not alternative.is_shown, alternative.nats))
    return tuple(
        Candidate(
            expression=to_infix(alternative.program, dataset.names),
            complexity=len(alternative.program),
            nats=finite(alternative.nats),
            r2=finite(alternative.r2),
            held_out_r2=finite(alternative.held_out_r2),
            cross_validated=alternative.is_cross_validated,
            origin=alternative.origin,
            selected=alternative.is_shown,
        )
        for place, alternative in enumerate(ordered)
        if place < MOST_CANDIDATES or alternative.origin == "guess"
    )


def correlations(pairs: Sequence[refinement.Correlation]) -> tuple[Correlation, ...]:
    """Return pairs of constants that the data hardly tell apart; ``constant`` counts an equation's ``constants``."""
    return tuple(
        Correlation(first=_place(*pair.first), second=_place(*pair.second), value=finite(pair.value)) for pair in pairs
    )


def _place(variable: str, number: int | None) -> Place:
    return Place(variable=variable, constant=number)


def covariance(known: refinement.Covariance | None) -> Covariance | None:
    """Return the joint covariance of all constants; ``constant`` counts an equation's ``constants``.

    It is null for a factor of one that is not written; these come in the order of the equation's ``implied``.
    """
    if known is None:
        return None
    return Covariance(
        constants=tuple(_place(*place) for place in known.constants),
        matrix=tuple(tuple(finite(value) for value in row) for row in known.matrix.tolist()),
        freedom=finite(known.degrees_of_freedom),
    )


def groups(recording: Recording | None, known: Sequence[GroupCovariance]) -> tuple[Group, ...]:
    """Return the groups of trajectories that may differ in constants, with the covariance of those of each."""
    if recording is None:
        return ()
    by_name = {fitted.group: fitted.covariance for fitted in known}
    return tuple(
        Group(
            group=name,
            trajectories=tuple(part.name for part in recording.trajectories if part.group == name),
            covariance=covariance(by_name.get(name)),
        )
        for name in recording.groups
    )


def simulation(known: refinement.Simulation | None, given: Preparation) -> Simulation | None:
    """Return the simulated trajectories, thinned, at the times of the user's file; None when there are none."""
    if known is None:
        return None
    recording = given.recording
    offset = recording.offset if recording is not None else 0.0
    numbers = len(known.trajectories) * (1 + 4 * len(known.states))
    names = _with_velocities(known.states, given.source)
    most = max(LEAST_POINTS, min(MOST_POINTS, MOST_NUMBERS // max(numbers, 1)))
    return Simulation(trajectories=tuple(_trajectory(part, known, offset, most, names) for part in known.trajectories))


def _with_velocities(states: Sequence[str], source: Source | None) -> tuple[str, ...]:
    """Return the states, and for order 2 their velocities behind them: what an initial state consists of."""
    if source is None or not source.velocities:
        return tuple(states)
    return (*states, *(source.velocities[source.states.index(name)] for name in states))


def _trajectory(
    part: refinement.Simulated, of: refinement.Simulation, offset: float, most: int, names: Sequence[str]
) -> Simulated:
    rows = thinned(len(part.times), most)
    return Simulated(
        name=part.name,
        held_out=part.held_out,
        r2=dict(zip(of.states, map(finite, part.r2), strict=True)),
        offsets={state: finite(value) for state, value in part.offsets.items()},
        start=_start(part, names),
        times=curve(part.times[rows] + offset, digits=12),
        measured=_curves(part.measured, of.states, rows),
        values=None if part.values is None else _curves(part.values, of.states, rows),
        lower=_beside(part, -of.quantile, of.states, rows),
        upper=_beside(part, of.quantile, of.states, rows),
    )


def _start(part: refinement.Simulated, names: Sequence[str]) -> dict[str, float | None] | None:
    if part.start is None:
        return None
    return {name: finite(value) for name, value in zip(names, part.start.tolist(), strict=False)}


Curves = dict[str, tuple[float | None, ...]]


def _beside(part: refinement.Simulated, errors: float, states: Sequence[str], rows: list[int]) -> Curves | None:
    """Return the curves so many standard errors above the simulated ones; None where these are not known."""
    if part.values is None or part.errors is None:
        return None
    with np.errstate(all="ignore"):
        return _curves(np.asarray(part.values + errors * part.errors), states, rows)


def _curves(values: FloatArray, states: Sequence[str], rows: list[int]) -> Curves:
    return {state: curve(row[rows]) for state, row in zip(states, values, strict=True)}
