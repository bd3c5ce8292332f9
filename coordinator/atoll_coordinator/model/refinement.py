"""The result of refining, before programs become text. Pure.

Constants, checks, covariances and simulations already have the classes of ``result.json`` (`atoll_coordinator.result`).
Equations are still programs here; `atoll_coordinator.model.result` writes them as text with names and units.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from atoll_coordinator.dimensions import EquationUnits
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.result.equations import Check, Constant, Estimate, Prediction, RunValue, SimpleTogether
from atoll_coordinator.result.findings import Chaos, Correlation, Covariance, Errors, Process
from atoll_coordinator.result.listed_trajectories import Simulation
from atoll_core.expression.program import Program
from atoll_core.expression.writing.expansion import Shape

Grade = Literal["exact", "good", "doubtful", "no model"]
JobKind = Literal["trajectories", "template", "target", "process"]
"""The kind of job decides which data test an equation: simulated trajectories (of a template: also what is unknown in
it), the rows of a target, or the steps of a stochastic process."""
CheckOutcome = Literal["passed", "failed", "not made", "not applicable"]
RefiningEnd = Literal["finished", "max-time", "not refined"]
"""How refining ended: finished, stopped by ``--max-time`` with the best result so far, or not run."""


@dataclass(frozen=True)
class UnitCoefficient:
    """The coefficient 1 of the term `of`, which is not written. `constant` is the fitted estimate of this coefficient,
    before it was rounded to 1."""

    of: Program
    constant: Estimate


@dataclass(frozen=True)
class Alternative:
    """An equation that was compared with the shown equation; for the other variables, the equations of the model were
    used.

    `nats` is the description length of the alternative minus the length of the shown equation. It is 0 for the shown
    equation, and negative if the alternative is shorter but predicts worse. Below about 3 nats the data hardly decide
    between the two. `r2` is the R2 of the simulated state. `held_out_r2` is the R2 on trajectories to which the
    alternative was not fitted: held-out trajectories or, if `is_cross_validated`, trajectories left out one at a time.
    It is None if there are no such trajectories. `unknown` is the searched unknown part of an equation with a template,
    and `parameters` are the values of the template's parameters.
    """

    program: Program
    nats: float
    r2: float | None
    held_out_r2: float | None = None
    is_shown: bool = False
    is_cross_validated: bool = False
    origin: Origin | None = None
    unknown: Program | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Refined:
    """The displayed equation of one variable. Before refining, it is an unchanged member of the front.

    `member` is the index of the front member from which the equation was derived; None if it has another origin.
    `error` is the job's loss and `mse` the mean squared error, both on all rows of the dataset. `constants` has an
    entry for each constant of `program`, in node order; it is empty before refining. `unit_coefficients` are the
    coefficients 1 that are not written. If groups of trajectories have their own constants, `by_group` has the program
    and constants of each group by name, and the constants of `program` that are not `shared` are means over the groups.
    `units` are the units of the constants, None if no unit is known. `simple_together` are simple numbers that two or
    more constants may have together; None if no such numbers are likely. With a template, `parameters` has for each
    constant the name of its parameter (None: it has none), and `unknowns` are the unknown parts by label. `runs` are
    the values of a parameter that differs by run; the equation is then its rate, 0.
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
    parameters: tuple[str | None, ...] = ()
    unknowns: Mapping[str, Program] = field(default_factory=dict)
    runs: tuple[RunValue, ...] = ()


@dataclass(frozen=True, eq=False)
class ObservedColumn:
    """A measured column that is computed from states: its program, the constants with errors, and the name of each
    constant that is a parameter."""

    program: Program
    constants: tuple[Constant, ...]
    parameters: tuple[str | None, ...]


@dataclass(frozen=True, eq=False)
class Refinement:
    """The result of refining a job. `equations` has no entry for a variable if no equation is better than the shown
    member of its front.

    `fluxes` are terms that share a fitted constant in several equations, such as a flux that leaves one state and
    enters another. Each flux has the shape of the term (without numbers) and, by variable, the multiple of the term in
    each equation. The multiple is None if the factor of the term was fitted separately in this equation. `covariance`
    is the covariance of all constants, `by_group` the covariance of each group of trajectories if groups have their own
    constants. `observations` are the measured columns that are computed from states.
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
    observations: Mapping[str, ObservedColumn] = field(default_factory=dict)
    end: RefiningEnd = "finished"
