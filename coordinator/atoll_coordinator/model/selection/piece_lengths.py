"""How much of a trajectory is simulated at a stretch: all of it, or where that cannot be fitted, shorter pieces.

Errors of an initial state grow along a trajectory; of a chaotic one, until nothing is left of it after some hundred
rows. Shorter pieces, each from an initial state of its own, can still be fitted. They tell less of a model, hence the
longest that can be fitted are taken.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from atoll.expression.program import Program
from atoll_coordinator.model.selection.comparison import Contest, Standing
from atoll_coordinator.model.selection.joint_search import Chosen, Field, ranked_candidates, selected
from atoll_coordinator.model.settings import SETTINGS


def chosen(field: Field) -> Chosen | None:
    """Return the best system of equations and the longest pieces it can be fitted to, None if it cannot at all."""
    if field.recording.offsets:
        field = replace(field, piece=_longest(field))
    lists = ranked_candidates(field)
    if not all(lists):
        return None
    found: list[Chosen] = []
    for choice in _ever_shorter(field, lists):
        found.append(choice)
        if _excess(choice.contest, choice.standing) <= SETTINGS.selection.noise_excess:
            work = sum(each.contest.shooter.work for each in found)
            return replace(
                choice if work >= SETTINGS.selection.pieces_work else _lengthened(field, choice, lists), lists=lists
            )
    return replace(found[0], lists=lists) if found else None


def on_all_rows(choice: Chosen) -> Chosen | None:
    """Return the chosen system fitted to all rows, in shorter pieces if it must be; None when it cannot be."""
    its = choice.field.measurements(choice.field.variables)
    if its.rows == choice.contest.shooter.measurements.rows:
        return choice
    found: list[Chosen] = []
    for field in _fields(choice.field):
        fitted = _fitted(field, choice.standing.programs, its.rows)
        if fitted is not None:
            found.append(fitted)
            if _excess(fitted.contest, fitted.standing) <= SETTINGS.selection.noise_excess:
                return fitted
    return found[0] if found else None


def remarks(field: Field) -> Iterator[str]:
    """Yield sentences for the user: trajectories were not simulated in whole, states are without an equation."""
    longest = _longest(field)
    if longest > field.piece:
        yield (
            f"Trajectories were simulated in pieces of {field.piece} rows or less, each from an initial state of its "
            f"own, not in whole (up to {longest} rows); beyond a piece the model has not been tested."
        )
    others = [state for state in field.recording.states if state not in field.variables]
    if others:
        yield (
            f"Simulations take {', '.join(others)}, without an equation, as smoothed; the errors of that add to what "
            "they leave."
        )


def _ever_shorter(field: Field, lists: Sequence[Sequence[Program]]) -> Iterator[Chosen]:
    """Yield the best system for whole trajectories, then, as long as that helps, for shorter pieces."""
    fields = _fields(field)
    work = 0
    for index, here in enumerate(fields):
        shorter = fields[index + 1 :]

        def is_hopeless(choice: Chosen, shorter: Sequence[Field] = shorter) -> bool:
            may_be = (
                _longest(choice.field) > SETTINGS.selection.long_trajectory
                or choice.contest.shooter.work >= SETTINGS.selection.dear_work
            )
            return may_be and _is_better_in(shorter, choice)

        choice = selected(here, lists, is_hopeless=is_hopeless)
        if choice is not None:
            yield choice
            work += choice.contest.shooter.work
            if work >= SETTINGS.selection.pieces_work or not _is_better_in(shorter, choice):
                return


def _is_better_in(fields: Sequence[Field], choice: Chosen) -> bool:
    """Tell whether a system that does not fit well does so in shorter pieces."""
    if _excess(choice.contest, choice.standing) <= SETTINGS.selection.noise_excess:
        return False
    rows = choice.contest.shooter.measurements.rows
    fits = (_fitted(field, choice.standing.programs, rows) for field in fields)
    return any(
        fit is not None and _excess(fit.contest, fit.standing) <= SETTINGS.selection.noise_excess for fit in fits
    )


def _lengthened(field: Field, choice: Chosen, lists: Sequence[Sequence[Program]]) -> Chosen:
    """Return what becomes of a system for short pieces if it holds for longer ones; itself if it does not."""
    rows = choice.contest.shooter.measurements.rows
    for longer in _fields(field):
        if longer.piece <= choice.field.piece:
            break
        fit = _fitted(longer, choice.standing.programs, rows)
        if fit is not None and _excess(fit.contest, fit.standing) <= SETTINGS.selection.noise_excess:
            return selected(longer, lists, choice.standing.programs) or choice
    return choice


def _fitted(field: Field, programs: Sequence[Program], rows: int) -> Chosen | None:
    """Return a system fitted to at most about so many rows, None when it cannot be simulated."""
    contest = field.contest(field.measurements(field.variables).thinned(rows), field.variables)
    standing = contest.stand(programs, SETTINGS.selection.piece_steps, SETTINGS.selection.piece_lengths)
    return None if standing is None else Chosen(field, contest, standing)


def _excess(contest: Contest, standing: Standing) -> float:
    """Return how many times as large as the noise the residuals are, of the state that is fitted worst.

    Where smoothed states are inputs, their errors are taken to leave as much as the noise again.
    """
    its = contest.shooter.measurements
    noise = np.maximum(its.noise, SETTINGS.selection.slight * its.scales[its.observed])
    allowed = noise * (2.0 if its.coherence > 1.0 else 1.0)
    return float(np.max(np.sqrt(standing.shot.squares) / allowed))


def _fields(field: Field) -> list[Field]:
    """Return the field with its own pieces, and with shorter ones that are at most half of the longest trajectory."""
    most = min(field.piece, _longest(field))
    return [field, *(replace(field, piece=rows) for rows in SETTINGS.selection.shorter_pieces if 2 * rows <= most)]


def _longest(field: Field) -> int:
    return max(len(each.times) for each in field.recording.trajectories if not each.held_out)
