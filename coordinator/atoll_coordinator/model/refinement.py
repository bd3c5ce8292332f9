"""What refining gives: equations with errors, alternatives, verdicts, simulations. Pure.

Letters: K constants of one program, T trajectories, R rows of one trajectory, S states.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from atoll_coordinator.dimensions import EquationUnits
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.stochastic.densities import StationaryDensity
from atoll_coordinator.stochastic.discretisation import Discretisation
from atoll_coordinator.stochastic.paths import Ensemble
from atoll_core.data.dataset import FloatArray
from atoll_core.data.notes import notes_of
from atoll_core.expression.program import Program
from atoll_core.expression.writing.expansion import Shape

Grade = Literal["exact", "good", "doubtful", "no model"]
JobKind = Literal["trajectories", "groups", "target", "process"]
"""Kinds of job by what an equation is tested against: simulated trajectories, with constants of their own for groups of
them or not; a target on rows; the steps of a stochastic process."""
CheckOutcome = Literal["passed", "failed", "not made", "not applicable"]
RefiningEnd = Literal["finished", "max-time", "not refined"]
"""How refining ended: by itself, by ``--max-time`` with the best so far, or without a result of its own."""


@dataclass(frozen=True)
class Check:
    """One check of an equation: its `name`, its `outcome`, and the `reason` as a clause.

    `value` is what was measured and `limit` what it is compared with. `power` is the smallest departure that the check
    would have seen, as a share of the variance of the state or target; None: it has none, or it is not known.
    """

    name: str
    outcome: CheckOutcome
    reason: str
    value: float | None = None
    limit: float | None = None
    power: float | None = None


@dataclass(frozen=True)
class SimpleNumber:
    """The most probable simple number near a constant.

    `odds` are those of this number against all others, `standard_errors` how many of these lie between it and the
    estimate.
    """

    value: float
    odds: float
    standard_errors: float


@dataclass(frozen=True)
class SimpleTogether:
    """Simple numbers of two and more constants of an equation, judged together.

    `constants` are their places among those of the equation, `values` the numbers, which are shown where each of them
    is singled out. `odds` are those of all of them against everything else, one at least. `chi_square` is by how much
    the squared residuals over their variance grow when the constants move from the best fit to these numbers, and the
    others follow.
    """

    constants: tuple[int, ...]
    values: tuple[float, ...]
    odds: float
    chi_square: float


@dataclass(frozen=True)
class Constant:
    """One constant of an equation as it is shown.

    `value` is printed: the estimate with the digits that its standard error leaves, or a simple number. `fitted` is its
    value by maximum likelihood, and `std_error` and `interval` (95 %) belong to that; `identifiable` is false where the
    data do not determine it. `simple` is the most probable simple number near it, None where there is none. `bounds`
    are those that the user has set, infinite on an open side. Where it `is_at_bound`, the data would have it beyond:
    there is no standard error, and 95 % of its distribution lie in the one-sided interval.
    """

    value: float
    fitted: float | None = None
    std_error: float | None = None
    interval: tuple[float, float] | None = None
    identifiable: bool = True
    simple: SimpleNumber | None = None
    bounds: tuple[float, float] | None = None
    is_at_bound: bool = False

    @property
    def is_within(self) -> bool:
        """Whether what is printed lies in the interval, if there is one."""
        return self.interval is None or self.interval[0] <= self.value <= self.interval[1]


@dataclass(frozen=True)
class UnitCoefficient:
    """A factor of one that is not written, of the term `of`; the constant has its value as it was fitted."""

    of: Program
    constant: Constant


@dataclass(frozen=True)
class Alternative:
    """An equation that was compared with the one shown, all other variables as in the model.

    `nats` is how much longer the description of the data is with it (0 for the one shown, negative where it is shorter
    but predicts less well; below about 3 the data hardly decide); `r2` is that of its state's simulation,
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


@dataclass(frozen=True)
class Correlation:
    """Two constants of a model that the data hardly tell apart: (variable, place among its constants), twice."""

    first: tuple[str, int]
    second: tuple[str, int]
    value: float


@dataclass(frozen=True, eq=False)
class Covariance:
    """The joint covariance `matrix` (P, P) of the constants of a model, all fitted together.

    `constants` has for each (variable, place among its constants), None for a factor of one that is not written: these
    are in the order of the equation's unit coefficients. Variances of constants that are not determined are infinite.
    Student's t has so many `degrees_of_freedom`.
    """

    constants: tuple[tuple[str, int | None], ...]
    matrix: FloatArray
    degrees_of_freedom: float


@dataclass(frozen=True)
class SharedTerm:
    """A term that was fitted in several equations together, such as a flux that leaves one state and enters another.

    Its numbers inside are the same in all of them. `multiples` has by variable how many times the flux stands in its
    equation, None where the factor is one of its own; `shape` is the term without numbers.
    """

    shape: Shape
    multiples: Mapping[str, float | None]


@dataclass(frozen=True)
class Prediction:
    """How far a state can be foretold from `starts` other initial states within the measured range.

    `followed` is from how many of them the model could be simulated, `unfinished` from how many that would take more
    integration steps than are allowed; from the others it runs away. `probability` is the share of the odds of models
    that foretell what the model does (R2 above 0.9), `novelty` how far the simulated rows lie from the measured ones:
    the median, over the widths of the range. `reached` is the value farthest beyond the measured range that the state
    takes there, None where it stays within. `measure_from` is the initial state from which a measurement would tell
    most, by state: the one from which rivals differ most, if any do, or else the one farthest from what was measured;
    `is_disputed` tells that rivals differ. Of rivals that agree along all that was measured, it is a state beside that.
    """

    starts: int
    followed: int
    probability: float
    novelty: float
    reached: float | None = None
    measure_from: Mapping[str, float] | None = None
    is_disputed: bool = False
    unfinished: int = 0


@dataclass(frozen=True)
class Chaos:
    """What is known of a model whose courses cannot be foretold for long.

    Errors grow e-fold in `lyapunov_time` (unit of time). `is_kept` tells whether a long simulation stays on what was
    measured: it does not run away, and its means and variances are those of the measurements, `probability` being that
    of differences as large as the largest one (None: it runs away, or it `is_unfinished`: there are not enough
    integration steps to tell).
    """

    lyapunov_time: float
    is_kept: bool
    probability: float | None
    is_unfinished: bool = False


@dataclass(frozen=True, eq=False)
class GroupEquation:
    """An equation with the constants of one `group` of trajectories, in node order."""

    group: str
    program: Program
    constants: tuple[Constant, ...]


@dataclass(frozen=True, eq=False)
class GroupCovariance:
    """The joint covariance of the constants of one `group`, shared ones among them; None where none was fitted."""

    group: str
    covariance: Covariance | None


@dataclass(frozen=True, eq=False)
class Refined:
    """The equation of one variable as it is shown; before refinement, a member of the front as it stands.

    `member` is the index of the front member it came from, None when it came from elsewhere; `error` is the job's loss
    and `mse` the mean squared error on all rows of the dataset; `constants` has one for each constant of `program`, in
    node order (empty before refinement); `unit_coefficients` has the factors of one that are not written. Where groups
    of trajectories have constants of their own, `by_group` has the equation of each, and `shared` says which constants
    all groups have in common; the other ones of `program` are means. `units` are those of the constants, None where no
    unit is known. `simple_together` are simple numbers of two and more constants, None where none are likely.
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
    by_group: tuple[GroupEquation, ...] = ()
    shared: tuple[bool, ...] = ()
    units: EquationUnits | None = None
    simple_together: SimpleTogether | None = None


@dataclass(frozen=True, eq=False)
class Simulated:
    """One trajectory by the model, from fitted initial conditions.

    `times` (R,) are centred as in the recording; `measured` (S, R) are the measured states, NaN where one is not used;
    `values` and `errors` (S, R) are the simulated states and the standard errors that those of the constants and
    initial conditions give them (None where the simulation ends early);
    `start` is the initial condition, states and then velocities, without offsets (None like `values`);
    `r2` has one number for each state, None where it could not be simulated to the end. `offsets` are what was measured
    minus the state, by the names of the states that have one; `values` include them.
    """

    name: str
    held_out: bool
    times: FloatArray
    measured: FloatArray
    values: FloatArray | None
    errors: FloatArray | None
    r2: tuple[float | None, ...]
    start: FloatArray | None = None
    offsets: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class StateErrors:
    """What the shown model's residuals say of the errors of one state.

    `sd` is their standard deviation in a row of average weight, in the state's unit; `proportional` the share of their
    variance that grows with the square of the value, where the state is as large as its root mean square; `correlated`
    the share that goes together between neighbouring rows, over about `rows` rows (None where there is none);
    `independent_rows` as how many rows they decide. `are_summed`: they add up along trajectories, as a solver's do, and
    `sd` is that within pieces of `piece` rows, to which constants were fitted.
    """

    sd: float
    proportional: float
    correlated: float
    rows: float | None
    independent_rows: float
    are_summed: bool
    piece: int | None = None


@dataclass(frozen=True, eq=False)
class Simulation:
    """The model's simulations of all trajectories; `states` are the column names in the order of their rows.

    A 95 % band lies `quantile` standard errors on either side (Student's t, as of the constants).
    """

    states: tuple[str, ...]
    trajectories: tuple[Simulated, ...]
    quantile: float


@dataclass(frozen=True, eq=False)
class MeasuredDensity:
    """The density that a process settles into, that of the measurements in the same bins, `measured` (S, B).

    `overlap` (S,) is the integral of the lesser of both.
    """

    settled: StationaryDensity
    measured: FloatArray
    overlap: FloatArray


@dataclass(frozen=True, eq=False)
class ProcessFindings:
    """What is known of a stochastic process as a whole.

    `steps` were measured, of this median `length`, and are those of this `discretisation`: by `discretisation_nats` the
    description is longer with the other. `log_likelihood` is the mean of a step in nats, `held_out` that of steps that
    took no part (None without). `noise` has the standard deviation of the errors of measurement of the states that show
    any; `ensemble` begins where the `trajectory` of this name does, at its centred times; `stationary` is None where
    the process does not settle.
    """

    states: tuple[str, ...]
    steps: int
    length: float
    discretisation: Discretisation
    discretisation_nats: float
    log_likelihood: float
    held_out: float | None
    noise: Mapping[str, Constant]
    trajectory: str
    ensemble: Ensemble | None
    stationary: MeasuredDensity | None


@dataclass(frozen=True, eq=False)
class Refinement:
    """Everything that refining a job gives; `equations` lacks variables of which the front has nothing better.

    `notes` are those among the `warnings` that are none.
    """

    equations: Mapping[str, Refined] = field(default_factory=dict)
    simulation: Simulation | None = None
    correlations: tuple[Correlation, ...] = ()
    errors: Mapping[str, StateErrors] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    chaos: Chaos | None = None
    process: ProcessFindings | None = None
    shared_terms: tuple[SharedTerm, ...] = ()
    covariance: Covariance | None = None
    by_group: tuple[GroupCovariance, ...] = ()
    end: RefiningEnd = "finished"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Keep which of the warnings are notes: what is read of bytes does not tell."""
        object.__setattr__(self, "notes", tuple(dict.fromkeys((*self.notes, *notes_of(self.warnings)))))
