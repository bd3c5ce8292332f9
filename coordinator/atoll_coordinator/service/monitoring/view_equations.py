"""The equations that views of live jobs show, written for people by the background thread.

To write the equation of a new front takes 0.1 to 0.25 s: the program is rewritten in the shortest form. The loop asks
for it when a client looks at the job. A question about the job is answered when the fronts that it had at that time are
written (`ViewEquations.awaited`); followers are shown the equation of an earlier front meanwhile. Only one front is
written at a time, in the order of the requests, and only the last front of each variable, so that other work of the
background thread waits for one equation at most.
"""

import itertools
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final
from weakref import WeakKeyDictionary

from atoll_coordinator.model.result.building import KNOWN, VariableOutcome, select_shown_equation
from atoll_coordinator.result.base import finite
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.tasks.preparing import Prepared
from atoll_core.expression.text.infix import to_infix


@dataclass(frozen=True, slots=True, eq=False)
class ViewFront:
    """A front whose equation is to be written. Nothing in it changes, so another thread may use it.

    Fronts are written in the order of their numbers.
    """

    number: int
    job: str
    prepared: Prepared
    outcome: VariableOutcome

    def write(self) -> "FrontWritten":
        """Return the written front, or the error of writing it."""
        try:
            return FrontWritten(self, self._fields())
        except Exception as error:  # the loop counts it
            return FrontWritten(self, {}, error)

    def _fields(self) -> Mapping[str, Any]:
        """Return the fields of a `VariableView` about the shown equation; none if no equation can be shown."""
        prepared, outcome = self.prepared, self.outcome
        text = prepared.config.prior.equations.get(outcome.variable)
        if text is not None and outcome.why == KNOWN:
            return {"expression": text}  # its parameters are not fitted yet
        shown = select_shown_equation(outcome, None, prepared.dataset, prepared.config)
        if shown is None:
            return {}
        target = prepared.dataset.problem(outcome.variable).target
        normalized = finite(target.normalized(shown.error))
        limit = target.convergence_threshold(prepared.config.budget.target_error)
        return {
            "error": finite(shown.error),
            "normalized_error": normalized,
            "complexity": len(shown.program),
            "expression": to_infix(shown.program, prepared.dataset.names),
            "converged": normalized is not None and normalized <= limit,
        }


@dataclass(frozen=True, slots=True, eq=False)
class FrontWritten:
    """The fields about the shown equation of a front; `error`: the error of writing it, then there are no fields."""

    front: ViewFront
    fields: Mapping[str, Any]
    error: Exception | None = None


class ViewEquations:
    """The last equation that was written of each variable of each live job. Only the loop calls its methods."""

    def __init__(self, write: Callable[[ViewFront], object]) -> None:
        """`write` starts to write a front in the background; `add_written` follows."""
        self._write: Final = write
        self._written: WeakKeyDictionary[Job, dict[str, FrontWritten]] = WeakKeyDictionary()
        self._wanted: dict[tuple[str, str], ViewFront] = {}
        self._writing: ViewFront | None = None
        self._numbers = itertools.count()

    def fields(self, job: Job, prepared: Prepared, outcome: VariableOutcome) -> Mapping[str, Any]:
        """Return the fields about the equation of the last front that was written; none: no front was written yet.

        If the present front is another one, it is written next.
        """
        written = self._written.get(job, {}).get(outcome.variable)
        last = written.front if written is not None else None
        if outcome.front and not any(_is_of(front, job.id, outcome) for front in (last, self._writing)):
            key = job.id, outcome.variable
            number = self._wanted[key].number if key in self._wanted else next(self._numbers)
            self._wanted[key] = ViewFront(number, job.id, prepared, outcome)
            self._begin()
        return written.fields if written is not None else {}

    def awaited(self, jobs: Collection[str]) -> int | None:
        """Return the number of the last front that is to be written for any of these jobs; None: there is none."""
        fronts = [*self._wanted.values(), *([self._writing] if self._writing is not None else ())]
        return max((front.number for front in fronts if front.job in jobs), default=None)

    def add_written(self, written: FrontWritten, job: Job | None) -> None:
        """Keep the fields for the views of a job (None: it has ended), and begin with the next front."""
        if job is not None:
            self._written.setdefault(job, {})[written.front.outcome.variable] = written
        self._writing = None
        self._begin()

    def _begin(self) -> None:
        if self._wanted and self._writing is None:
            self._writing = self._wanted.pop(next(iter(self._wanted)))
            self._write(self._writing)


def _is_of(front: ViewFront | None, job: str, outcome: VariableOutcome) -> bool:
    """Return whether this is the front of an outcome of a job."""
    if front is None or (front.job, front.outcome.variable) != (job, outcome.variable):
        return False
    return front.outcome.front == outcome.front
