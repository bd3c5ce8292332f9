"""What comes closest to the chosen equations, and whether one of these foretells better. Pure.

Where two descriptions are nearly as long, trajectories that were left out decide between them: their misfit takes the
place of the misfit to all trajectories and of the price of constants, which stands for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.expression.evaluation import values_of
from atoll.expression.program import Program, structure
from atoll_coordinator.model.criteria import validated_length
from atoll_coordinator.model.selection.comparison import Contest, Standing
from atoll_coordinator.model.selection.cross_validation import Validated, Validation
from atoll_coordinator.model.selection.joint_search import Chosen
from atoll_coordinator.model.settings import SETTINGS


@dataclass(frozen=True, eq=False)
class Rival:
    """A system with another equation for one variable, and how well it foretells, if that was looked at."""

    standing: Standing
    validated: Validated | None = None


@dataclass(frozen=True, eq=False)
class Race:
    """How the race ended: who won, how well that system foretells, and by equation what came closest."""

    choice: Chosen
    validated: Validated | None
    rivals: tuple[tuple[Rival, ...], ...]


def decided(choice: Chosen, inputs: FloatArray) -> Race:
    """Return the end of the race.

    Args:
        choice: the shortest description.
        inputs: points (V, R) at which equations are compared.
    """
    choice, rivals = _shortest(choice, inputs)
    is_held_out = any(each.held_out for each in choice.field.recording.trajectories)
    validation = Validation(choice.contest)
    if is_held_out or not validation.is_possible:
        return Race(choice, None, tuple(tuple(map(Rival, its)) for its in rivals))
    own = validation.of(choice.standing)
    validated = [_validated(validation, its, choice.standing) for its in rivals]
    winner = _winner(choice.standing, own, validated)
    if winner is not None:
        choice = replace(choice, standing=winner.standing)
        own = winner.validated or own
        validated = [_validated(validation, its, choice.standing) for its in _all_rivals(choice, inputs)]
    return Race(choice, own, tuple(map(tuple, validated)))


def _shortest(choice: Chosen, inputs: FloatArray) -> tuple[Chosen, list[list[Standing]]]:
    """Return the choice and its rivals, none of which is shorter: what lost to others once may win beside these."""
    while True:
        rivals = _all_rivals(choice, inputs)
        best = min((each for its in rivals for each in its[:1]), key=lambda its: its.nats, default=choice.standing)
        if best.nats > choice.standing.nats - SETTINGS.selection.least_gain:
            return choice, rivals
        choice = replace(choice, standing=best)


def _winner(standing: Standing, own: Validated, rivals: Sequence[Sequence[Rival]]) -> Rival | None:
    """Return the rival that is close behind and foretells best, and clearly better than the one in front, or None.

    Those with more constants are left out: what these gain on few trajectories is chance as often as not.
    """
    best, winner = validated_length(own.misfit, standing.programs) - SETTINGS.selection.clearly_better_nats, None
    for each in (rival for its in rivals for rival in its):
        if each.validated is None or each.standing.nats > standing.nats + SETTINGS.selection.undecided_nats:
            continue
        if len(each.standing.shot.system.places) > len(standing.shot.system.places):
            continue
        nats = validated_length(each.validated.misfit, each.standing.programs)
        if nats < best:
            best, winner = nats, each
    return winner


def _validated(validation: Validation, rivals: Sequence[Standing], best: Standing) -> list[Rival]:
    return [
        Rival(
            each,
            validation.of(each)
            if rank < SETTINGS.selection.validated and each.nats <= best.nats + SETTINGS.selection.validated_nats
            else None,
        )
        for rank, each in enumerate(rivals)
    ]


def _all_rivals(choice: Chosen, inputs: FloatArray) -> list[list[Standing]]:
    contest = choice.contest
    return [
        [] if index in contest.fixed else _rivals(contest, choice.standing, index, inputs)
        for index in range(len(choice.standing.programs))
    ]


def _rivals(contest: Contest, best: Standing, index: int, inputs: FloatArray) -> list[Standing]:
    """Return what came closest with another equation for one variable, distinct in function, the closest first."""
    tried = sorted(
        (each for (equation, _), each in contest.tried.items() if equation == index), key=lambda its: its.nats
    )
    programs: dict[bytes, Program] = {structure(each.programs[index]): each.programs[index] for each in tried}
    near = contest.halved(
        best,
        index,
        list(programs.values())[: 4 * SETTINGS.selection.alternatives],
        SETTINGS.selection.alternative_rounds,
    )
    functions = [values_of(best.programs[index], inputs)]
    found: list[Standing] = []
    for each in near:
        values = values_of(each.programs[index], inputs)
        if all(_differ(values, other) for other in functions):
            functions.append(values)
            found.append(each)
    return found[: SETTINGS.selection.alternatives]


def _differ(first: FloatArray, second: FloatArray) -> bool:
    with np.errstate(all="ignore"):
        difference = float(np.sqrt(np.mean((first - second) ** 2)))
        return not difference <= SETTINGS.selection.same_function * float(np.std(second))
