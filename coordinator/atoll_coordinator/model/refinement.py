"""The result of refining, before programs become text. Pure.

Numbers that stand in ``result.json`` are held as the parts of a result from the start (`atoll_coordinator.result`):
constants, checks, covariances, simulations. The classes here have a program, the file has its text: only
`atoll_coordinator.model.result` knows the names and units for it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from atoll_coordinator.dimensions import EquationUnits
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.result.equations import Check, Constant, Estimate, Prediction, SimpleTogether
from atoll_coordinator.result.findings import Chaos, Correlation, Covariance, Errors, Process
from atoll_coordinator.result.listed_trajectories import Simulation
from atoll_core.expression.program import Program
from atoll_core.expression.writing.expansion import Shape

Grade = Literal["exact", "good", "doubtful", "no model"]
JobKind = Literal["trajectories", "target", "process"]
"""Kinds of job by what an equation is tested against: simulated trajectories, a target on rows, or the steps of a
stochastic process."""
CheckOutcome = Literal["passed", "failed", "not made", "not applicable"]
RefiningEnd = Literal["finished", "max-time", "not refined"]
"""How refining ended: by itself, by ``--max-time`` with the best so far, or without a result of its own."""


@dataclass(frozen=True)
class UnitCoefficient:
    """A factor of one that is not written, of the term `of`; the constant has its value as it was fitted."""

    of: Program
    constant: Estimate


@dataclass(frozen=True)
class Alternative:
    """An equation that was compared with the one shown, all other variables as in the model.

    `nats` is how much longer the description of the data is with it (0 for the one shown, negative where it is shorter
    but predicts less well; below about 3 the data hardly decide); `r2` is the R2 of its state's simulation,
    `held_out_r2` the same on trajectories that did not take part in its fit, None where there are none:
    held-out ones, or when it `is_cross_validated` each of the others, left out one at a time.
    """

    program: Program
    nats: float
    r2: float | None
    held_out_r2: float | None = None
    is_shown: bool = False
    is_cross_validated: bool = False
    origin: Origin | None = None


@dataclass(frozen=True, eq=False)
class Refined:
    """The equation of one variable as it is shown; before refinement, a member of the front as it stands.

    `member` is the index of the front member it came from, None when it came from elsewhere; `error` is the job's loss
    and `mse` the mean squared error on all rows of the dataset; `constants` has one for each constant of `program`, in
    node order (empty before refinement); `unit_coefficients` has the factors of one that are not written. Where groups
    of trajectories have constants of their own, `by_group` has program and constants of each, by the group's name; the
    constants of `program` that are not `shared` by all groups are means. `units` are the units of the constants, None
    where no unit is known. `simple_together` are simple numbers of two and more constants, None where none are likely.
    """

    member: int | None
    program: Program
    error: float
    mse: float
    constants: tuple[Constant, ...] = ()
    unit_coefficients: tuple[UnitCoefficient, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    grade: Grade | None = None
    reason: str | None = None
    checks: tuple[Check, ...] = ()
    origin: Origin | None = None
    prediction: Prediction | None = None
    by_group: Mapping[str, tuple[Program, tuple[Constant, ...]]] = field(default_factory=dict)
    units: EquationUnits | None = None
    simple_together: SimpleTogether | None = None


@dataclass(frozen=True, eq=False)
class Refinement:
    """Everything that refining a job gives; `equations` lacks variables of which the front has nothing better.

    `fluxes` are terms that were fitted in several equations together, such as one that leaves one state and enters
    another: the term without numbers, and by variable how many times it stands in its equation, None where the factor
    was fitted by itself. `covariance` is the covariance of all constants, `by_group` the covariance of each group of
    trajectories if groups have their own constants.
    """

    equations: Mapping[str, Refined] = field(default_factory=dict)
    simulation: Simulation | None = None
    correlations: tuple[Correlation, ...] = ()
    errors: Mapping[str, Errors] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    chaos: Chaos | None = None
    process: Process | None = None
    fluxes: tuple[tuple[Shape, Mapping[str, float | None]], ...] = ()
    covariance: Covariance | None = None
    by_group: Mapping[str, Covariance | None] = field(default_factory=dict)
    end: RefiningEnd = "finished"
