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
from atoll_coordinator.stochastic import Discretisation

InputKind = Literal["smooth", "shape-preserving", "held"]
"""How an input goes from row to row, see `docs/data.md`."""
Kind = Literal["dynamics", "process", "regression"]


class Place(Part):
    """A constant by the variable of its equation and its place there; None for a factor of one nobody writes."""

    variable: Text
    constant: Count | None = None


class Correlation(Part):
    """Two constants that the data hardly tell apart."""

    first: Place
    second: Place
    value: Number = None


class Covariance(Part):
    """The joint covariance of the `constants`; Student's t has so many degrees of `freedom`."""

    constants: tuple[Place, ...]
    matrix: tuple[Curve, ...]
    freedom: Number = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if any(len(row) != len(self.constants) for row in (self.matrix, *self.matrix)):
            raise misfit("this result has a covariance of other constants than it names; give it as it was written")
        return self


class Group(Part):
    """A group of trajectories that may differ in constants from the others."""

    group: Text
    trajectories: tuple[Text, ...] = ()
    covariance: Covariance | None = None


class SharedTerm(Part):
    """A term that equations have in common; `multiples`: how often a flux that they share stands in each."""

    term: Text
    has_function: Flag | None = False
    factors: Numbers = Field(default_factory=dict)
    multiples: Numbers | None = None


class Quantisation(Part):
    """The rounding that is seen in the digits of a state."""

    kind: Text | None = None
    step: Number = None
    error: Number = None


class LargestResidual(Part):
    """The largest distance from the smoothed curve, and where that is."""

    value: Number = None
    trajectory: Text | None = None
    time: Number = None


class ExcludedRows(Part):
    """Times along a trajectory at which a state is not used, for one reason."""

    trajectory: Text
    reason: Text | None = None
    times: Curve = ()


class Errors(Part):
    """What the residuals of the shown model say of the errors of a state."""

    sd: Number = None
    proportional: Number = None
    correlated: Number = None
    correlation_rows: Number = None
    independent_rows: Number = None
    add_up: Flag | None = False
    piece: Count | None = None


class Noise(Part):
    """The errors of measurement of a state, and how it was smoothed."""

    sd: Number = None
    relative: Number = None
    method: Text | None = None
    span: Count | None = None
    degree: Count | None = None
    quantisation: Quantisation | None = None
    residual_rms: Number = None
    largest_residual: LargestResidual | None = None
    doubtful_rows: Count | None = None
    outliers: Count | None = None
    doubtful: tuple[ExcludedRows, ...] = ()
    errors: Errors | None = None

    @property
    def error(self) -> float | None:
        """The standard deviation of errors: what residuals of the model say, else the first estimate."""
        return self.sd if self.errors is None else self.errors.sd


class Chaos(Part):
    """What is known of a model whose courses cannot be foretold for long."""

    lyapunov_time: Number = None
    is_kept: Flag | None = None
    is_unfinished: Flag | None = None
    probability: Number = None


class MeasurementNoise(Part):
    """The errors of measurement of a state of a stochastic process."""

    sd: Number = None
    std_error: Number = None
    interval: Pair | None = None


class PathEnsemble(Part):
    """Simulated paths of a process: their mean, median and the bounds that 5 % lie beyond, by state."""

    trajectory: Text | None = None
    paths: Count | None = None
    finite_paths: Count | None = None
    times: Curve = ()
    mean: Curves = Field(default_factory=dict)
    lower: Curves = Field(default_factory=dict)
    median: Curves = Field(default_factory=dict)
    upper: Curves = Field(default_factory=dict)


class Density(Part):
    """The density of a state that simulations settle into, between edges, beside the measured one."""

    mean: Number = None
    sd: Number = None
    overlap: Number = None
    edges: Curve = ()
    density: Curve = ()
    measured: Curve = ()


class Process(Part):
    """A stochastic process as a whole."""

    steps: Count | None = None
    step: Positive
    discretisation: Discretisation = "local linearisation"
    discretisation_nats: Number = None
    log_likelihood: Number = None
    held_out_log_likelihood: Number = None
    measurement_noise: dict[Text, MeasurementNoise] = Field(default_factory=dict)
    ensemble: PathEnsemble | None = None
    stationary: dict[Text, Density] | None = None


class Regression(Part):
    """Measured and fitted values of the target of y = f(X) beside its variables: of all `rows` those `listed`."""

    rows: Count | None = None
    listed: Count | None = None
    variables: Curves = Field(default_factory=dict)
    measured: Curve = ()
    fitted: Curve = ()


class System(Part):
    """What the columns are, their units, and the range of each variable in the rows that were searched."""

    kind: Kind | None = None
    order: Count = 1
    time: Text | None = None
    states: tuple[Text, ...] = ()
    velocities: tuple[Text, ...] = ()
    inputs: tuple[Text, ...] = ()
    input_kinds: dict[Text, InputKind] = Field(default_factory=dict)
    target: Text | None = None
    units: dict[Text, Text] = Field(default_factory=dict)
    ranges: dict[Text, Pair] = Field(default_factory=dict)


class Data(Part):
    """Where the data come from, and what was measured; `trajectories`: None where states have no time."""

    digest: Text | None = None
    files: tuple[Text, ...] = ()
    rows: Count | None = None
    read_as: Text | None = None
    trajectories: tuple[Recorded, ...] | None = None
