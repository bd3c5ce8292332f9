"""What a result says of the model as a whole: columns, data, noise, errors of constants, processes, regressions."""

from typing import Literal, Self

from pydantic import Field, model_validator

from atoll_coordinator.result.base import (
    Count,
    Curve,
    Curves,
    Flag,
    Number,
    Numbers,
    Pair,
    Part,
    Positive,
    Text,
    misfit,
)
from atoll_coordinator.result.listed_trajectories import Recorded
from atoll_coordinator.stochastic.discretisation import Discretisation

InputKind = Literal["smooth", "shape-preserving", "held"]
"""How an input goes from row to row, see `docs/data.md`."""
Kind = Literal["dynamics", "process", "regression"]


class Place(Part):
    """A constant by the variable of its equation and its place there; None for a factor of one that is not written."""

    variable: Text = Field(description="variable of the equation")
    constant: Count | None = Field(
        default=None, description="place among its `constants`, null for a factor of 1 (in the order of `implied`)"
    )


class Correlation(Part):
    """Two constants that the data hardly tell apart."""

    first: Place = Field(description="a constant")
    second: Place = Field(description="another one")
    value: Number = Field(default=None, description="their correlation")


class Covariance(Part):
    """The joint covariance of the `constants`; Student's t has so many degrees of `freedom`."""

    constants: tuple[Place, ...] = Field(description="which constants")
    matrix: tuple[Curve, ...] = Field(description="their covariance")
    freedom: Number = Field(default=None, description="degrees of freedom of Student's t")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if any(len(row) != len(self.constants) for row in (self.matrix, *self.matrix)):
            raise misfit("this result has a covariance of other constants than it names; give it as it was written")
        return self


class Group(Part):
    """A group of trajectories that may differ in constants from the others."""

    group: Text = Field(description="name of the group")
    trajectories: tuple[Text, ...] = Field(default=(), description="its trajectories")
    covariance: Covariance | None = Field(default=None, description="covariance of its constants")


class SharedTerm(Part):
    """A term that equations have in common; `multiples`: how often a flux that they share stands in each."""

    term: Text = Field(description="the term without its factor")
    has_function: Flag | None = Field(default=False, description="whether it has a function or number inside")
    factors: Numbers = Field(default_factory=dict, description="its factor by variable")
    multiples: Numbers | None = Field(
        default=None, description="how often a flux stands in each equation, null where it was not fitted together"
    )


class Quantisation(Part):
    """The rounding that is seen in the digits of a state."""

    kind: Text | None = Field(default=None, description="kind of rounding")
    step: Number = Field(default=None, description="its step")
    error: Number = Field(default=None, description="standard deviation of its errors")


class LargestResidual(Part):
    """The largest distance from the smoothed curve, and where that is."""

    value: Number = Field(default=None, description="measured minus smoothed")
    trajectory: Text | None = Field(default=None, description="where")
    time: Number = Field(default=None, description="when")


class ExcludedRows(Part):
    """Times along a trajectory at which a state is not used, for one reason."""

    trajectory: Text = Field(description="where")
    reason: Text | None = Field(default=None, description="`end`, `gap`, `jump`, `outlier` or `missing`")
    times: Curve = Field(default=(), description="when")


class Errors(Part):
    """What the residuals of the shown model say of the errors of a state."""

    sd: Number = Field(default=None, description="standard deviation in a row of average weight")
    proportional: Number = Field(default=None, description="share of the variance that grows with the squared value")
    correlated: Number = Field(default=None, description="share of the variance that is correlated between rows")
    correlation_rows: Number = Field(default=None, description="over how many rows")
    independent_rows: Number = Field(default=None, description="number of independent rows")
    add_up: Flag | None = Field(
        default=False, description="whether errors accumulate along trajectories, like those of a solver"
    )
    piece: Count | None = Field(default=None, description="rows of the pieces to which constants were fitted then")


class Noise(Part):
    """The errors of measurement of a state, and how it was smoothed."""

    sd: Number = Field(default=None, description="standard deviation of the errors of measurement")
    relative: Number = Field(default=None, description="`sd` over the state's standard deviation")
    method: Text | None = Field(default=None, description="method of smoothing")
    span: Count | None = Field(default=None, description="its span in rows")
    degree: Count | None = Field(default=None, description="degree of its polynomials")
    quantisation: Quantisation | None = Field(default=None, description="rounding seen in the digits")
    residual_rms: Number = Field(default=None, description="root mean square of measured minus smoothed values")
    largest_residual: LargestResidual | None = Field(default=None, description="the largest of them")
    doubtful_rows: Count | None = Field(default=None, description="rows whose derivative is not reliable")
    outliers: Count | None = Field(default=None, description="number of outliers")
    doubtful: tuple[ExcludedRows, ...] = Field(default=(), description="rows that are not used")
    errors: Errors | None = Field(default=None, description="what the residuals of the model say")

    @property
    def error(self) -> float | None:
        """The standard deviation of errors: what residuals of the model say, else the first estimate."""
        return self.sd if self.errors is None else self.errors.sd


class Chaos(Part):
    """What is known of a model whose trajectories cannot be predicted for long."""

    lyapunov_time: Number = Field(default=None, description="time in which errors grow by a factor of e")
    is_kept: Flag | None = Field(
        default=None, description="whether a long simulation keeps the measured means and variances"
    )
    is_unfinished: Flag | None = Field(default=None, description="whether it needed too many integration steps")
    probability: Number = Field(default=None, description="probability of differences as large by chance")


class MeasurementNoise(Part):
    """The errors of measurement of a state of a stochastic process."""

    sd: Number = Field(default=None, description="standard deviation")
    std_error: Number = Field(default=None, description="its standard error")
    interval: Pair | None = Field(default=None, description="its 95 % interval")


class PathEnsemble(Part):
    """Simulated paths of a process: their mean, median and the bounds that 5 % lie beyond, by state."""

    trajectory: Text | None = Field(default=None, description="whose initial state and inputs it has")
    paths: Count | None = Field(default=None, description="number of paths")
    finite_paths: Count | None = Field(default=None, description="paths that stay finite")
    times: Curve = Field(default=(), description="times")
    mean: Curves = Field(default_factory=dict, description="mean by state")
    lower: Curves = Field(default_factory=dict, description="5 % of the paths are below")
    median: Curves = Field(default_factory=dict, description="median by state")
    upper: Curves = Field(default_factory=dict, description="5 % of the paths are above")


class Density(Part):
    """The density of a state that simulations settle into, between edges, beside the measured one."""

    mean: Number = Field(default=None, description="mean")
    sd: Number = Field(default=None, description="standard deviation")
    overlap: Number = Field(default=None, description="integral of the lesser of both densities")
    edges: Curve = Field(default=(), description="edges of the bins")
    density: Curve = Field(default=(), description="simulated density in each bin")
    measured: Curve = Field(default=(), description="measured density in each bin")


class Process(Part):
    """A stochastic process as a whole."""

    steps: Count | None = Field(default=None, description="number of steps")
    step: Positive = Field(description="median length of a step")
    discretisation: Discretisation = Field(
        default="local linearisation",
        description="`local linearisation`, or `Euler-Maruyama` where rows are steps of that method",
    )
    discretisation_nats: Number = Field(default=None, description="Δ description length of the other one")
    log_likelihood: Number = Field(default=None, description="mean log-likelihood of a step in nats")
    held_out_log_likelihood: Number = Field(default=None, description="the same of held-out trajectories")
    measurement_noise: dict[Text, MeasurementNoise] = Field(default_factory=dict, description="by state")
    ensemble: PathEnsemble | None = Field(default=None, description="simulated paths")
    stationary: dict[Text, Density] | None = Field(
        default=None,
        description="density that simulations settle into, by state; null where they do not, or with inputs",
    )


class Regression(Part):
    """Measured and fitted values of the target of y = f(X) beside its variables: of all `rows` those `listed`."""

    rows: Count | None = Field(default=None, description="number of rows")
    listed: Count | None = Field(default=None, description="number of rows that are here, at most 1,000")
    variables: Curves = Field(default_factory=dict, description="by name")
    measured: Curve = Field(default=(), description="values of the target")
    fitted: Curve = Field(default=(), description="values of the equation")


class System(Part):
    """What the columns are, their units, and the range of each variable in the rows that were searched."""

    kind: Kind | None = Field(default=None, description="`dynamics`, `process` or `regression`")
    order: Count = Field(default=1, description="order of the equations")
    time: Text | None = Field(default=None, description="time column")
    states: tuple[Text, ...] = Field(default=(), description="state columns")
    velocities: tuple[Text, ...] = Field(default=(), description="names of the velocities for order 2")
    inputs: tuple[Text, ...] = Field(default=(), description="input columns")
    input_kinds: dict[Text, InputKind] = Field(default_factory=dict, description="curve of each input between rows")
    target: Text | None = Field(default=None, description="target column")
    units: dict[Text, Text] = Field(default_factory=dict, description="by column")
    ranges: dict[Text, Pair] = Field(
        default_factory=dict, description="least and largest value in the rows that were searched"
    )


class Data(Part):
    """Where the data come from, and what was measured; `trajectories`: None where states have no time."""

    digest: Text | None = Field(default=None, description="sha256 of the table")
    files: tuple[Text, ...] = Field(default=(), description="names of the files")
    rows: Count | None = Field(default=None, description="number of rows")
    read_as: Text | None = Field(default=None, description="how they were read")
    trajectories: tuple[Recorded, ...] | None = Field(
        default=None, description="what was measured, null where states have no time"
    )
