"""Every threshold by which the preparation of data decides what is computed, by stage, each with its reason.

Numbers of presentation stand where they are used, and so do mathematical constants and the sizes of compiled kernels.
"""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class CheckSettings:
    """What measurements must have before anything is computed from them."""

    min_rows: int = 5
    """Fewest rows of a trajectory that has a derivative, and of any search."""
    turns: tuple[tuple[float, str, str], ...] = ((6.283185307179586, "2 pi", ""), (360.0, "360", ":deg"))
    """A full turn, how it is called, and what `--angle` appends for its unit."""
    least_turn: float = 0.5
    """A wrapped angle covers more than this share of a turn, and a jump of it is larger than this share."""
    most_turn: float = 1.001
    """A wrapped angle covers at most this share of a turn; the excess is rounding of the measurements."""
    jump_over_neighbours: float = 4.0
    """A jump of a wrapped angle is more than this many times as large as the steps beside it."""
    jump_excess: float = 3.0
    """A jump differs from a full turn by at most this many times the steps beside it."""
    jump_rounding: float = 1e-3
    """Share of a turn by which a jump may differ in addition, for states that hardly move otherwise."""
    smallest_weight: float = 1e-6
    """Rows of a smaller weight, over the largest, are negligible beside the others and left out."""


@dataclass(frozen=True)
class TrajectorySettings:
    """How times are taken, and where a trajectory is split."""

    time_rounding: float = 4.0
    """Times are even when they are so within this many units in the last place of the largest one."""
    largest_rounding: float = 0.1
    """They are made even only where that precision is less than this share of the step."""
    bridged_steps: int = 20
    """A gap of at most so many median steps is bridged, however narrow the spans: times drawn at random come that far
    apart only once in a million rows."""
    least_rows_in_pieces: float = 0.5
    """Share of the rows, at least, that pieces long enough to be differentiated must hold: else gaps are bridged."""


@dataclass(frozen=True)
class SmoothingSettings:
    """How span, degree and thinning of loess are selected."""

    degrees: tuple[int, ...] = (3, 4)
    """Degrees tried. By values alone a parabola passes for a cubic, but its slope has far more bias: measured, the
    derivative error was up to 2.8 times the standard error with it and up to 1.9 times without."""
    paper_degrees: tuple[int, ...] = (2,)
    """The degree of Schmidt & Lipson 2008."""
    span_ratio: float = 1.25
    """Each span tried over the one before."""
    smallest_span: int = 5
    """Narrowest span tried, in bins: the fewest rows of a trajectory."""
    largest_span: int = 1001
    """Widest span tried, in bins."""
    patience: int = 5
    """Spans without a better score after which wider ones are not tried."""
    most_leverage: float = 0.999
    """Mean leverage from which on a smoother reproduces the data and has no score."""
    many_rows: int = 2000
    """More rows than this are thinned if possible, to half as many bins or more."""
    least_bins_in_span: int = 40
    """Bins in the narrowest span for which rows may be thinned: means over a fortieth of a span have lost nothing."""
    least_bins: int = 20
    """A signal of no more rows than this is never thinned, a longer one never to fewer bins."""
    thinning_ratio: int = 4
    """By so much less rows are thinned when the span that was selected has too few bins."""
    narrow_spans: tuple[int, ...] = (9, 18, 36)
    """Spans in rows, by which it is judged whether thinning has lost a fast wave."""
    judged_rows: int = 4000
    """Of more bins than this, one in k is judged when span and degree are selected."""
    narrower: float = 0.6
    """The bias of a derivative is estimated by its difference from that with a span as many times as wide."""


@dataclass(frozen=True)
class RobustnessSettings:
    """How outliers are recognised (Cleveland 1979, section 2)."""

    rounds: int = 6
    """Most rounds of smoothing and weighing; with fewer outliers it ends earlier."""
    reach: float = 6.0
    """Residuals beyond this many times the median one have no weight (Cleveland 1979)."""
    least_residual: float = 1e-5
    """Share of the state's standard deviation that the median residual counts as at least: of data without noise, bias
    and rounding must not be taken for outliers."""
    isolated: float = 0.5
    """An outlier's neighbours have at most this share of its residual; at a jump that is not resolved they have
    more."""
    fewest: int = 3
    """Tails are heavy when at least so many residuals are isolated and far out: fewer may be chance."""
    rows_per_outlier: int = 150
    """Tails are heavy when so are at least one in this many: measured with noise of 0.2 to 10 % there were at most 2 in
    400 without outliers."""
    most_outliers: float = 0.1
    """Share of the rows beyond which outliers are hardly errors of measurement."""


@dataclass(frozen=True)
class InterpolationSettings:
    """When states are interpolated rather than smoothed."""

    stencil_rows: int = 15
    """The widest stencil, as the kernels have it."""
    largest_noise: float = 3e-4
    """Noise, as a share of the state's standard deviation, beyond which data are never interpolated."""
    smallest_noise: float = 1e-9
    """Noise, as a share of the state's standard deviation, below which data count as free of it."""
    agreement: float = 2.0
    """Estimates of the noise by two stencils agree when they differ by at most so many standard errors. Simulated on
    pure noise, even and uneven steps, 50 to 1,000 rows: the estimate is 1.03 to 1.09 times the truth on average."""
    judged_shares: tuple[float, ...] = (0.95, 0.75)
    """Shares of the rows, the best ones, by which interpolation and smoothing are compared: jumps must not decide, nor
    must rows at rest. Without noise interpolation wins by either; with noise it loses by a factor near 1.5 by both."""
    least_freedom: float = 1e-12
    """Smallest 1 - leverage by which a residual is divided."""
    end_rows: int = 4
    """Rows at each end of a trajectory whose derivatives by interpolation are much worse than the others'."""
    trimmed_length: int = 20
    """Shortest trajectory whose ends are left out."""


@dataclass(frozen=True)
class QuantisationSettings:
    """When values count as multiples of a step."""

    judged_rows: int = 2000
    """Rows that are looked at, spread evenly: all values show the step."""
    fewest_values: int = 8
    """With fewer distinct values a step is chance as often as not."""
    written_steps: float = 3.0
    """Differences of at most so many steps of the last digit are those of writing numbers down."""
    shares_of_least: tuple[int, ...] = (1, 2, 3)
    """The step is the least difference of two values, or one of these shares of it."""
    improbable: float = 1e-6
    """Probability below which values are not near multiples of a step by chance, which the step was fitted to."""


@dataclass(frozen=True)
class RowSettings:
    """Which rows the search is given, and why others are said to be left out."""

    always_certain: float = 1e-5
    """Rows whose interpolated derivative is uncertain by less than this share of its standard deviation are kept."""
    over_median_uncertainty: float = 5.0
    """Rows whose uncertainty is less than this many times the median one are kept as well."""
    least_interpolated: float = 0.7
    """Share of the rows of interpolated states that is kept however uncertain they are."""
    least_smoothed: float = 0.8
    """Share of the rows of smoothed states that is kept however uncertain they are."""
    most_uneven: float = 2.0
    """Root mean square of the uncertainty over its mean, at most, on the rows selected."""
    least_variation: float = 1e-3
    """A derivative that varies less than this share of its mean is judged by the mean: it may well be constant."""
    most_searched: int = 2_000
    """More rows than about this are thinned for the search: a derivative rests on the measurements of many neighbours,
    and two thousand show every turn of a curve that a search can find."""
    passes: int = 3
    """A wild row swells the standard deviation by which rows are judged, so that they are judged again without it."""
    below_median_weight: float = 25.0
    """Targets whose weight is less than the median one over this have more than five times the error: they are left out
    of the search, which counts all rows alike (ADR 0027)."""
    least_weighted: float = 0.8
    """Share of the rows that is kept whatever their weight."""
    equal_weights: float = 1e-12
    """Weights whose standard deviation is at most this share of their mean count as equal."""
    gap_steps: float = 3.0
    """A step of the times this many times as long as the median one of its trajectory is told as a gap."""
    end_share: float = 0.25
    """Rows within this share of a span from the end of a trajectory have neighbours on one side, mostly."""


@dataclass(frozen=True)
class ScaleSettings:
    """The standard deviation by which values are judged."""

    rounding: float = 1e-12
    """A column that varies less than this share of its mean is judged by the mean: it may well be constant."""
    smallest: float = 1e-150
    """Numbers below this, or above its inverse, have no square that can be told from zero or infinity."""


@dataclass(frozen=True)
class DataSettings:
    """All thresholds of the preparation of data."""

    checks: CheckSettings = CheckSettings()
    trajectories: TrajectorySettings = TrajectorySettings()
    smoothing: SmoothingSettings = SmoothingSettings()
    robustness: RobustnessSettings = RobustnessSettings()
    interpolation: InterpolationSettings = InterpolationSettings()
    quantisation: QuantisationSettings = QuantisationSettings()
    rows: RowSettings = RowSettings()
    scale: ScaleSettings = ScaleSettings()
    guesses_per_population: int = 4
    """At most one of so many individuals begins as a guess."""


SETTINGS: Final = DataSettings()
"""The values in use."""
