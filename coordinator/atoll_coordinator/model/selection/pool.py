"""The pool of candidates: the ranked programs for each equation, and the best system of a few of them.

Proposals come in stages (`STAGES`). Each call of `add` ranks the new programs of each equation by its trajectories
alone (`candidates`), then fits a few systems of the best ones. If the residuals of a system are noise, there is a limit
of length: longer programs are not added, because no decrease of the misfit could compensate their length. Doubt:
`is_sufficient` can stop too early if the best system fits by chance; later stages try further programs.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

from atoll_coordinator.model.selection.candidates import RankedCandidates
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.joint_search import find_starting_system
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import Program

Proposer = Callable[[ModellingTask, str, float], Iterable[Program]]
"""Proposes programs for the equation of a variable: (task, name of the variable, length limit in nats)."""


class CandidatePool:
    """Candidates of every equation, and the `best` system of a few of them, which calibrates the errors."""

    def __init__(
        self, task: ModellingTask, comparison: ModelComparison, fixed_candidates: Mapping[str, Sequence[Program]],
        best: FittedModel | None = None, *, is_calibrating: bool = True,
    ) -> None:  # fmt: skip
        """Create a pool. If a variable is in `fixed_candidates`, its equation has only the candidates given there.

        The `best` system, if there is one already, has calibrated the errors of the `comparison`. If `is_calibrating`
        is False, better systems do not calibrate the comparison again, so that old and new lengths can be compared.
        """
        self._is_calibrating = is_calibrating
        self.comparison = comparison
        self.best = best
        self._task = task
        self._ranked = {
            name: _rank_alone(task, name, comparison) for name in task.variables if name not in fixed_candidates
        }
        self._fitted: set[bytes] = set()
        self.lists: list[list[Program]] = [list(fixed_candidates.get(name, ())) for name in task.variables]

    def add(self, propose: Proposer) -> None:
        """Add the programs that a proposer returns for each equation."""
        calls = [partial(self._add_to, propose, equation) for equation, _ in enumerate(self._task.variables)]
        self._task.spread.run_calls(calls)
        if not all(self.lists):
            return
        start = find_starting_system(self.comparison, self.lists, self._fitted)
        if start is not None and (self.best is None or start.nats < self.best.nats):
            self.best = start
            if self._is_calibrating:
                self.comparison, self.best = self.comparison.calibrate(start)

    def _add_to(self, propose: Proposer, equation: int) -> None:
        """Add the programs that a proposer returns for one equation; may run in a separate thread."""
        task, name = self._task, self._task.variables[equation]
        if name not in self._ranked:
            return
        if task.is_over:
            self.lists[equation] = self.lists[equation] or _programs_of_search(task, name)
            return
        most = math.inf if self.best is None else self.comparison.score.length_limit(self.best, equation)
        ranked = self._ranked[name]
        ranked.add(propose(task, name, most), most)
        first = task.candidates[name].simulated
        programs = ranked.programs if first is None else [first, *ranked.programs]
        admitted = map(task.restrictions(name).admitted, programs)
        self.lists[equation] = [one for one in admitted if one is not None and task.may_be_shown(one)]

    @property
    def longest(self) -> float:
        """Nats of the longest equation of the best system. Only equations with ranked candidates count; 0 if there are
        none."""
        programs = [] if self.best is None else self.best.programs
        pairs = zip(self._task.variables, programs, strict=False)
        searched = [program for name, program in pairs if name in self._ranked]
        return max(map(self.comparison.score.length, searched), default=0.0)

    @property
    def is_sufficient(self) -> bool:
        """Whether further candidates are unlikely to shorten the description.

        False if a longer system could still reduce the misfit by more than it adds to the length. Also False if a
        shorter system may be missing. This is so in two cases: targets are so uncertain that the search cannot
        distinguish equations of the same error (for example bar magnets with 5 % of noise), or an equation is longer
        than laws usually are.
        """
        if self.best is None or self.comparison.score.may_be_improved(self.best):
            return False
        if self.longest > SETTINGS.selection.usual_length:
            return False
        targets = (self._task.dataset.problem(name).target for name in self._ranked)
        return all(target.uncertainty <= SETTINGS.inference.largest_uncertainty for target in targets)


def _programs_of_search(task: ModellingTask, name: str) -> list[Program]:
    """Return the programs of the search for an equation, used if no time is left to rank candidates.

    First come the programs that describe the target up to its uncertainty, the shortest first; then the other programs,
    sorted by their error.
    """
    target, members = task.dataset.problem(name).target, task.candidates[name].front
    limit = (target.uncertainty * target.standard_deviation) ** 2
    describing = [member.program for member in members if member.mse <= limit]
    rest = [member.program for member in reversed(members) if member.mse > limit]
    admitted = map(task.restrictions(name).admitted, [*describing, *rest])
    return [one for one in admitted if one is not None and task.may_be_shown(one)]


def _rank_alone(task: ModellingTask, name: str, whole: ModelComparison) -> RankedCandidates:
    measurements = task.measurements([name])
    if measurements.hidden:  # its estimated course is as uncertain as the measured states
        noise = max(smoothing.relative_noise for smoothing in task.recording.smoothing)
        measurements = measurements.with_measured_course(noise)
    measurements = measurements.thin(SETTINGS.selection.compared_rows)
    return RankedCandidates(task.make_comparison(measurements, [name]), task.dataset.problem(name), whole)
