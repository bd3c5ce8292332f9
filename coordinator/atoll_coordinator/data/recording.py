"""The measurements of a job, trajectory by trajectory, and how they were smoothed.

The search uses a `atoll_core.data.dataset.Dataset` of smoothed rows. Later stages fit and judge models by the measured
states recorded here. Pure data. Letters: R rows of one trajectory, S states, U inputs.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from atoll_core.data.dataset import Dataset, FloatArray
from atoll_core.expression.program import Program

Method = Literal["interpolation", "loess", "robust loess", "hidden"]
InputKind = Literal["smooth", "shape-preserving", "held"]
"""Kinds of an input between rows. Smooth: a curve with continuous second derivatives (de Boor 1978, chapter IV);
shape-preserving: a curve without overshoot where the input is switched (Fritsch & Butland 1984); held: the value of a
row until the next row (zero-order hold)."""
Reason = Literal["end", "gap", "jump", "outlier", "missing"]
"""Why a row is not used: near an end of its trajectory, near a gap in the times, where the state changes too fast for
the sampling or for the smoother, an outlier, or a missing value that the other rows do not determine."""
STENCIL_ROWS: Final = 15
"""Rows of the widest stencil of an interpolation. It is defined here so that modules that count rows need not load
kernels."""


@dataclass(frozen=True)
class StateQuantisation:
    """How a state was rounded: the `kind`, the `step` (for the largest values, if it varies), the `error`.

    Values may be rounded to a decimal place, to significant digits, to float32, or to multiples of a step, as an
    encoder does. `error` is the root mean square of the rounding errors, in the state's unit.
    """

    kind: Literal["decimals", "digits", "single precision", "steps"]
    step: float
    error: float


@dataclass(frozen=True)
class ExcludedRow:
    """A row that is not used because of one state: the index of its `trajectory`, and its `row` in this trajectory."""

    trajectory: int
    row: int
    reason: Reason


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One continuous measurement; arrays in C order.

    `name` is its number from 1, or the value of the trajectory column. `times` (R,) ascend strictly, centred over all
    trajectories; `measured`, `smoothed` and `slopes` are (S, R), angles unwrapped and in radians; `slopes` are first
    derivatives. `inputs` and `input_slopes` are (U, R): an input between rows is the cubic with these values and
    slopes; slopes are NaN for an input that is held at its value until the next row. `held_out` trajectories are not
    used in the search or in any fit.

    `measured` is NaN where a value is missing; `is_known` (S, R) tells where `smoothed` is known, None: everywhere.
    `robustness_weights` (S, R), from 0 (an outlier) to 1, reduce the weight of single measurements; None: all are 1.
    `weights` (R,) divide the variance of the errors of each row and are 1 on average over all rows; None: all are 1.
    `rates` and `rate_errors` (S, R) are the derivatives (the targets of the search) and their standard errors including
    the estimated bias, infinite where the state is not known; None: they were not kept. `group` is one of the groups of
    the recording, if it has any.
    """

    name: str
    times: FloatArray
    measured: FloatArray
    smoothed: FloatArray
    slopes: FloatArray
    inputs: FloatArray
    input_slopes: FloatArray
    held_out: bool = False
    robustness_weights: FloatArray | None = None
    weights: FloatArray | None = None
    is_known: npt.NDArray[np.bool_] | None = None
    rates: FloatArray | None = None
    rate_errors: FloatArray | None = None
    group: str = ""


@dataclass(frozen=True)
class StateSmoothing:
    """How one state was smoothed.

    `noise` is the estimated standard deviation of its measurement errors, in its unit and in rows of weight 1. For an
    interpolated state it is an upper estimate, often of rounding errors only. `relative_noise` is the noise over the
    state's pooled standard deviation. `span` (rows) and `degree` are the parameters of loess, None for an interpolated
    state. `uncertain_rows` counts the rows whose derivative is too uncertain to be used, `outliers` the rows of
    robustness weight 0. `excluded_rows` are the rows, in order, that are not used because of this state; held-out
    trajectories have none. `narrower_noise` is the noise by loess of the same degree with the `narrower_span` (rows):
    `span` was chosen for small residuals, so that `noise` is slightly too small. `quantisation` tells how the state was
    rounded, None if its digits show no rounding; `noise` is at least its error.
    """

    state: str
    method: Method
    noise: float
    relative_noise: float
    span: int | None = None
    degree: int | None = None
    uncertain_rows: int = 0
    outliers: int = 0
    excluded_rows: tuple[ExcludedRow, ...] = ()
    narrower_noise: float = 0.0
    narrower_span: int = 0
    quantisation: StateQuantisation | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """All trajectories of a job.

    `states` and `inputs` are column names, `state_symbols` and `input_symbols` the names in expressions, in the order
    of the arrays' rows; `offsets` are the states that are measured up to an unknown offset in each trajectory. With
    `order` 2 the variables of expressions are the states, then `velocity_symbols`, then the inputs. `offset` was
    subtracted from the times of the file to centre them. `groups` are the names of groups of trajectories with
    constants of their own; empty: all trajectories share the constants. A row is the mean of about `rows_of_mean` rows
    of the file. `input_kinds` has the kind of each input between rows; empty: not known. `input_error` is the largest
    error of these curves over the standard deviations of the inputs. `hidden` are the last states, which no column
    measures: their `measured` values are NaN, and their `smoothed` values are the course by the job's template.
    `observed` are the columns among the states that are computed from states and have no equation of their own.
    `initial` are bounds on initial values: name of the state, lower and upper bound, which are equal if it is given.
    """

    states: tuple[str, ...]
    state_symbols: tuple[str, ...]
    velocity_symbols: tuple[str, ...]
    inputs: tuple[str, ...]
    input_symbols: tuple[str, ...]
    order: Literal[1, 2]
    offset: float
    smoothing: tuple[StateSmoothing, ...]
    trajectories: tuple[Trajectory, ...]
    offsets: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()
    rows_of_mean: int = 1
    input_kinds: tuple[InputKind, ...] = ()
    input_error: float = 0.0
    hidden: tuple[str, ...] = ()
    observed: tuple[str, ...] = ()
    initial: tuple[tuple[str, float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class SampledPath:
    """One trajectory of a stochastic process; arrays in C order.

    `name` and `times` (R,) are as in `Trajectory`; `states` (S, R) and `inputs` (U, R) are as they were measured, all
    finite. `held_out` paths are not used in the search or in any fit.
    """

    name: str
    times: FloatArray
    states: FloatArray
    inputs: FloatArray
    held_out: bool = False


def component_name(one: str, other: str) -> str:
    """Return the name of a component of the diffusion: quadratic variation ``[x]`` or covariation ``[x,y]``."""
    return f"[{one}]" if one == other else f"[{one},{other}]"


@dataclass(frozen=True, eq=False)
class ProcessRecording:
    """All trajectories of a stochastic process: dx = f dt + g dW.

    Names and `offset` are as in `Recording`. `noise` (S,) is a first estimate of the variance of measurement errors, 0
    if none are detected; `pairs` are the components of the diffusion g g' that are searched, as pairs (i, j) of indices
    of states, i <= j.
    """

    states: tuple[str, ...]
    state_symbols: tuple[str, ...]
    inputs: tuple[str, ...]
    input_symbols: tuple[str, ...]
    offset: float
    paths: tuple[SampledPath, ...]
    noise: FloatArray | None = None
    pairs: tuple[tuple[int, int], ...] = ()

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components of the diffusion: quadratic variations ``[x]`` and covariations ``[x,y]``."""
        return tuple(component_name(self.states[i], self.states[j]) for i, j in self.pairs)


@dataclass(frozen=True)
class Source:
    """The table of a preparation, and the roles of its columns; column names are without units.

    `digest` is the hex sha256 of the uploaded table, `units` are the units in its header by column (columns without a
    unit are left out); `read_as` says how its files were read. The `states` have equations of `order`, unless there is
    a `target`: then only the target has an equation. `velocities` are variables for order 2.
    """

    digest: str
    files: tuple[str, ...]
    rows: int
    units: Mapping[str, str]
    time: str | None
    states: tuple[str, ...]
    velocities: tuple[str, ...]
    inputs: tuple[str, ...]
    target: str | None
    order: Literal[1, 2]
    read_as: str = ""


@dataclass(frozen=True)
class FoundMinima:
    """What fits of a template from many `starts` found: `reached` fits ended at the best minimum.

    `rivals` are the other minima that describe the rows almost as well: by how many nats each is worse, and its values
    of the parameters.
    """

    starts: int
    reached: int
    rivals: tuple[tuple[float, tuple[float, ...]], ...] = ()


@dataclass(frozen=True, eq=False)
class Preparation:
    """The result of preparing a table.

    `dataset` is for the search. `recording` has the trajectories of differentiated states; it is None if the left-hand
    sides were given, and for a stochastic process, whose trajectories are in `process` (else None). `held_out` has the
    same targets over rows of held-out trajectories, with uncertainty, standard deviation and noise of `dataset`; None
    if no trajectory is held out.

    If the left-hand sides were given, `counted` has the rows that fits use, with the `weights`. It includes rows whose
    weight is too small for the search, which gives all its rows equal weight. `counted` None: the rows of `dataset`;
    `weights` None: all are 1. `source` is the table; None: not known. `parameters` are the parameters of the job's
    template as the derivatives determine them, or a fit from many starts (`minima`); fits start with them.
    `parts` are the programs that stood for unknown parts in this fit, by equation.
    """

    dataset: Dataset
    recording: Recording | None = None
    held_out: Dataset | None = None
    weights: FloatArray | None = None
    process: ProcessRecording | None = None
    source: Source | None = None
    counted: Dataset | None = None
    parameters: tuple[float, ...] = ()
    minima: FoundMinima | None = None
    parts: Mapping[str, Program] = field(default_factory=dict)


def by_group(preparation: Preparation) -> Iterator[Preparation]:
    """Yield a preparation for each group of trajectories that may have constants of its own."""
    dataset, recording = preparation.dataset, preparation.recording
    if recording is None:
        return
    for place, group in enumerate(recording.groups):
        rows = np.flatnonzero(dataset.groups == place)
        targets = tuple(dataset.problem(name).of_group(place).target for name in dataset.variables)
        inputs = np.ascontiguousarray(dataset.inputs[:, rows])
        part = replace(dataset, inputs=inputs, targets=targets, groups=None)
        trajectories = (trajectory for trajectory in recording.trajectories if trajectory.group == group)
        of_group = tuple(replace(trajectory, group="") for trajectory in trajectories)
        yield Preparation(part, replace(recording, trajectories=of_group, groups=()))
