"""The pool of candidates: the programs proposed for each equation, ranked, and the best system of a few of them.

Proposals come in stages. As soon as the residuals of a system are noise, programs so long that no misfit could
compensate are no longer added.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

from atoll_coordinator.model.selection.candidates import RankedCandidates
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.joint_search import combine
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import Program

Proposer = Callable[[ModellingTask, str, float], Iterable[Program]]
"""Proposes programs for the equation of a variable, shorter than this many nats (see `ModelComparison.length`)."""


class CandidatePool:
    """Candidates of every equation, and the `best` system of a few of them, by which errors are calibrated."""

    def __init__(
        self, task: ModellingTask, comparison: ModelComparison, given: Mapping[str, Sequence[Program]],
        best: FittedModel | None = None, *, is_calibrating: bool = True,
    ) -> None:  # fmt: skip
        """Candidates of some variables may be `given`: there are no others of these.

        The `best` system, if there is one already, has calibrated the errors of the `comparison`. Unless the pool
        `is_calibrating`, better systems do not calibrate it again, so that old and new lengths can be compared.
        """
        self._is_calibrating = is_calibrating
        self.comparison = comparison
        self.best = best
        self._task = task
        self._ranked = {name: _alone(task, name, comparison) for name in task.variables if name not in given}
        self.lists: list[list[Program]] = [list(given.get(name, ())) for name in task.variables]

    def add(self, propose: Proposer) -> None:
        """Add the programs that are proposed for each equation."""
        calls = [partial(self._add_to, propose, equation) for equation, _ in enumerate(self._task.variables)]
        self._task.spread.branches(calls)
        if not all(self.lists):
            return
        begun = combine(self.comparison, self.lists)
        if begun is not None and (self.best is None or begun.nats < self.best.nats):
            self.best = begun
            if self._is_calibrating:
                self.comparison, self.best = self.comparison.calibrated(begun)

    def _add_to(self, propose: Proposer, equation: int) -> None:
        """Add the programs that are proposed for one equation, independently of the others."""
        task, name = self._task, self._task.variables[equation]
        if name not in self._ranked:
            return
        if task.is_over:
            self.lists[equation] = self.lists[equation] or _found_by_search(task, name)
            return
        most = math.inf if self.best is None else self.comparison.score.affordable(self.best, equation)
        ranked = self._ranked[name]
        ranked.add(propose(task, name, most), most)
        admitted = map(task.restrictions(name).admitted, ranked.programs)
        self.lists[equation] = [one for one in admitted if one is not None and task.may_be_shown(one)]

    @property
    def longest(self) -> float:
        """Nats of the longest equation of the best system that has candidates, 0 without any."""
        programs = [] if self.best is None else self.best.programs
        pairs = zip(self._task.variables, programs, strict=False)
        sought = [program for name, program in pairs if name in self._ranked]
        return max(map(self.comparison.score.length, sought), default=0.0)

    @property
    def suffices(self) -> bool:
        """Whether neither a longer system could gain its length nor a shorter one be missing.

        One may be missing if targets are too uncertain for the search to distinguish a law from others of the same
        error (bar magnets at 5 % of noise), and where an equation is longer than laws usually are.
        """
        if self.best is None or self.comparison.score.has_room(self.best):
            return False
        if self.longest > SETTINGS.selection.usual_length:
            return False
        targets = (self._task.dataset.problem(name).target for name in self._ranked)
        return all(target.uncertainty <= SETTINGS.inference.largest_uncertainty for target in targets)


def _found_by_search(task: ModellingTask, name: str) -> list[Program]:
    """Return the programs of the search for an equation, to be simulated if no time is left to choose.

    First come the shortest programs that describe the target up to its uncertainty, then the others by their error.
    """
    target, members = task.dataset.problem(name).target, task.candidates[name].front
    limit = (target.uncertainty * target.standard_deviation) ** 2
    describing = [member.program for member in members if member.mse <= limit]
    rest = [member.program for member in reversed(members) if member.mse > limit]
    admitted = map(task.restrictions(name).admitted, [*describing, *rest])
    return [one for one in admitted if one is not None and task.may_be_shown(one)]


def _alone(task: ModellingTask, name: str, whole: ModelComparison) -> RankedCandidates:
    measurements = task.measurements([name]).thinned(SETTINGS.selection.compared_rows)
    return RankedCandidates(task.compare(measurements, [name]), task.dataset.problem(name), whole)
