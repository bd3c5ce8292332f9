"""The parts of a result about the whole model: columns, data, noise, errors of constants, processes, regressions."""

from typing import Literal, Self

from pydantic import Field, model_validator

from atoll_coordinator.process_steps import Discretisation
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
    inconsistent,
)
from atoll_coordinator.result.listed_trajectories import Recorded

InputKind = Literal["smooth", "shape-preserving", "held"]
"""Interpolation of an input between rows, see `docs/data.md`."""
Kind = Literal["dynamics", "process", "regression"]


class Place(Part):
    """Identifies a constant by the variable of its equation and its position there."""

    variable: Text = Field(description="variable of the equation")
    constant: Count | None = Field(
        default=None, description="position in the list `constants`; null for factors of 1, in the order of `implied`"
    )


class Correlation(Part):
    """Two constants that the data hardly distinguish."""

    first: Place = Field(description="a constant")
    second: Place = Field(description="another constant")
    value: Number = Field(default=None, description="their correlation")


class Covariance(Part):
    """The joint covariance of several constants."""

    constants: tuple[Place, ...] = Field(description="constants, in the order of rows and columns")
    matrix: tuple[Curve, ...] = Field(description="their covariance")
    freedom: Number = Field(default=None, description="degrees of freedom of Student's t for intervals")

    @model_validator(mode="after")
    def _check_size(self) -> Self:
        if any(len(row) != len(self.constants) for row in (self.matrix, *self.matrix)):
            raise inconsistent(
                "the covariance in this result does not match its constants; give the unchanged result.json"
            )
        return self


class Group(Part):
    """A group of trajectories; its constants may differ from the constants of other groups."""

    group: Text = Field(description="name of the group")
    trajectories: tuple[Text, ...] = Field(default=(), description="its trajectories")
    covariance: Covariance | None = Field(default=None, description="covariance of its constants")


class SharedTerm(Part):
    """A term that occurs in several equations."""

    term: Text = Field(description="the term without its factor")
    has_function: Flag | None = Field(default=False, description="whether the term contains a function or a number")
    factors: Numbers = Field(default_factory=dict, description="its factor by variable")
    multiples: Numbers | None = Field(
        default=None,
        description="factor of the common term in each equation, null if the equations were not fitted together",
    )


class Quantisation(Part):
    """The rounding of a state, as seen in its digits."""

    kind: Text | None = Field(default=None, description="kind of rounding")
    step: Number = Field(default=None, description="step of the rounding")
    error: Number = Field(default=None, description="standard deviation of the rounding errors")


class LargestResidual(Part):
    """The largest distance of a measurement from the smoothed curve."""

    value: Number = Field(default=None, description="measured minus smoothed")
    trajectory: Text | None = Field(default=None, description="where")
    time: Number = Field(default=None, description="when")


class ExcludedRows(Part):
    """Times along a trajectory at which a state is not used, with the reason."""

    trajectory: Text = Field(description="where")
    reason: Text | None = Field(default=None, description="`end`, `gap`, `jump`, `outlier` or `missing`")
    times: Curve = Field(default=(), description="when")


class Errors(Part):
    """Errors of a state, estimated from the residuals of the displayed model."""

    sd: Number = Field(default=None, description="standard deviation in a row of average weight")
    proportional: Number = Field(default=None, description="share of the variance that grows with the squared value")
    correlated: Number = Field(default=None, description="share of the variance that is correlated between rows")
    correlation_rows: Number = Field(default=None, description="number of rows over which errors are correlated")
    independent_rows: Number = Field(default=None, description="number of independent rows")
    add_up: Flag | None = Field(
        default=False, description="whether errors accumulate along trajectories, like the errors of a solver"
    )
    piece: Count | None = Field(
        default=None, description="if errors accumulate: rows in each piece to which constants were fitted"
    )


class Noise(Part):
    """The measurement errors of a state, and how it was smoothed."""

    sd: Number = Field(default=None, description="standard deviation of the measurement errors")
    relative: Number = Field(default=None, description="`sd` over the state's standard deviation")
    method: Text | None = Field(default=None, description="method of smoothing")
    span: Count | None = Field(default=None, description="span of smoothing in rows")
    degree: Count | None = Field(default=None, description="degree of the smoothing polynomials")
    quantisation: Quantisation | None = Field(default=None, description="rounding, as seen in the digits")
    residual_rms: Number = Field(default=None, description="root mean square of measured minus smoothed values")
    largest_residual: LargestResidual | None = Field(
        default=None, description="the largest difference between measured and smoothed values"
    )
    doubtful_rows: Count | None = Field(default=None, description="rows whose derivative is not reliable")
    outliers: Count | None = Field(default=None, description="number of outliers")
    doubtful: tuple[ExcludedRows, ...] = Field(default=(), description="rows that are not used")
    errors: Errors | None = Field(default=None, description="errors estimated from the residuals of the model")

    @property
    def error(self) -> float | None:
        """The standard deviation of errors, estimated from residuals of the model, else from smoothing."""
        return self.sd if self.errors is None else self.errors.sd


class Chaos(Part):
    """Properties of a chaotic model, whose trajectories cannot be predicted for long."""

    lyapunov_time: Number = Field(default=None, description="time in which errors grow by a factor of e")
    is_kept: Flag | None = Field(
        default=None, description="whether a long simulation has the measured means and variances"
    )
    is_unfinished: Flag | None = Field(
        default=None, description="whether the long simulation needed too many integration steps"
    )
    probability: Number = Field(default=None, description="probability of differences at least as large by chance")


class MeasurementNoise(Part):
    """The measurement errors of a state of a stochastic process."""

    sd: Number = Field(default=None, description="standard deviation")
    std_error: Number = Field(default=None, description="its standard error")
    interval: Pair | None = Field(default=None, description="its 95 % interval")


class PathEnsemble(Part):
    """Simulated paths of a process: mean, median and the 5 % and 95 % quantiles of each state."""

    trajectory: Text | None = Field(
        default=None, description="trajectory with the same initial state and the same inputs"
    )
    paths: Count | None = Field(default=None, description="number of paths")
    finite_paths: Count | None = Field(default=None, description="paths that stay finite")
    times: Curve = Field(default=(), description="times")
    mean: Curves = Field(default_factory=dict, description="mean by state")
    lower: Curves = Field(default_factory=dict, description="5 % quantile by state")
    median: Curves = Field(default_factory=dict, description="median by state")
    upper: Curves = Field(default_factory=dict, description="95 % quantile by state")


class Density(Part):
    """The simulated stationary density of a state, and the measured density."""

    mean: Number = Field(default=None, description="mean")
    sd: Number = Field(default=None, description="standard deviation")
    overlap: Number = Field(default=None, description="integral of the smaller of the two densities")
    edges: Curve = Field(default=(), description="edges of the bins")
    density: Curve = Field(default=(), description="simulated density in each bin")
    measured: Curve = Field(default=(), description="measured density in each bin")


class Process(Part):
    """A stochastic process: all properties of the whole model."""

    steps: Count | None = Field(default=None, description="number of steps from row to row")
    step: Positive = Field(description="median length of a step")
    discretisation: Discretisation = Field(
        default="local linearisation",
        description="`local linearisation`, or `Euler-Maruyama` if rows are steps of this method",
    )
    discretisation_nats: Number = Field(default=None, description="Δ description length of the other discretisation")
    log_likelihood: Number = Field(default=None, description="mean log-likelihood of a step in nats")
    held_out_log_likelihood: Number = Field(
        default=None, description="mean log-likelihood of a step of held-out trajectories in nats"
    )
    measurement_noise: dict[Text, MeasurementNoise] = Field(default_factory=dict, description="by state")
    ensemble: PathEnsemble | None = Field(default=None, description="simulated paths")
    stationary: dict[Text, Density] | None = Field(
        default=None,
        description="stationary density by state; null if simulations do not reach one, or with inputs",
    )


class Regression(Part):
    """Measured and fitted values of the target of y = f(X), and its variables."""

    rows: Count | None = Field(default=None, description="number of rows")
    listed: Count | None = Field(default=None, description="number of rows listed here, at most 1,000")
    variables: Curves = Field(default_factory=dict, description="by name")
    measured: Curve = Field(default=(), description="values of the target")
    fitted: Curve = Field(default=(), description="values of the equation")


class System(Part):
    """Roles and units of the columns, and the range of each variable in the rows of the search."""

    kind: Kind | None = Field(default=None, description="`dynamics`, `process` or `regression`")
    order: Count = Field(default=1, description="order of the equations")
    time: Text | None = Field(default=None, description="time column")
    states: tuple[Text, ...] = Field(default=(), description="state columns")
    velocities: tuple[Text, ...] = Field(default=(), description="names of the velocities with order 2")
    inputs: tuple[Text, ...] = Field(default=(), description="input columns")
    input_kinds: dict[Text, InputKind] = Field(
        default_factory=dict, description="interpolation of each input between rows"
    )
    target: Text | None = Field(default=None, description="target column")
    units: dict[Text, Text] = Field(default_factory=dict, description="by column")
    ranges: dict[Text, Pair] = Field(
        default_factory=dict, description="smallest and largest value in the rows of the search"
    )


class Data(Part):
    """The source of the data, and the measurements."""

    digest: Text | None = Field(default=None, description="sha256 of the table")
    files: tuple[Text, ...] = Field(default=(), description="names of the files")
    rows: Count | None = Field(default=None, description="number of rows")
    read_as: Text | None = Field(default=None, description="how the files were read")
    trajectories: tuple[Recorded, ...] | None = Field(
        default=None, description="measured trajectories, null if states have no time"
    )
