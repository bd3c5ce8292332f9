"""Every number set by hand that decides which equation is shown and what is said of it, by stage, with its reason.

Numbers of presentation stand where they are used, and so do mathematical constants, guards against division by zero,
the sizes of compiled kernels and the numerics of minimisers and integrators.
"""

import ast
import os
from dataclasses import dataclass, replace
from typing import Any, Final

Rounds = tuple[tuple[int, int], ...]
"""How a comparison is narrowed down: in each round the steps of a fit, and how many systems stay."""


@dataclass(frozen=True)
class CommonSettings:
    """Numbers of more than one stage; shares are of a state's or a derivative's standard deviation."""

    negligible: float = 1e-3
    """A share that nobody sees or asks for."""
    clean: float = 1e-5
    """Noise or uncertainty below this share is none: of data without noise, bias and rounding are about as large."""


@dataclass(frozen=True)
class CheckSettings:
    """What measurements must have before anything is computed from them."""

    min_rows: int = 5
    """Fewest rows of a trajectory that has a derivative, of a span, and of any search: a cubic and one to judge it."""
    smallest: float = 1e-150
    """Guard: numbers below this, or above its inverse, have no square that can be told from zero or infinity."""
    by_chance: float = 0.01
    """Probability, at most, that jumps are as near to a full turn by chance where a column is taken for an angle."""


@dataclass(frozen=True)
class SmoothingSettings:
    """How span, degree and thinning of loess are selected."""

    degrees: tuple[int, ...] = (3, 4)
    """Degrees tried. By values alone a parabola passes for a cubic, but its slope has far more bias: measured, the
    derivative error was up to 2.8 times the standard error with it and up to 1.9 times without."""
    span_ratio: float = 1.25
    """Each span tried over the one before."""
    patience: int = 5
    """Spans without a better score after which wider ones are not tried."""
    least_bins_in_span: int = 40
    """Bins in the narrowest span for which rows may be thinned: means over a fortieth of a span have lost nothing."""
    narrower: float = 0.6
    """The bias of a derivative is estimated by its difference from that with a span as many times as wide."""


@dataclass(frozen=True)
class RobustnessSettings:
    """How outliers are recognised (Cleveland 1979, section 2)."""

    rounds: int = 6
    """Most rounds of judging rows by what rows judged before are like; nearly all settle earlier."""
    reach: float = 6.0
    """Residuals beyond this many times the median one have no weight (Cleveland 1979)."""
    isolated: float = 0.5
    """An outlier's neighbours have at most this share of its residual; at a jump that is not resolved they have
    more."""
    fewest: int = 3
    """Tails are heavy when at least so many residuals are isolated and far out: fewer may be chance."""
    rows_per_outlier: int = 150
    """Tails are heavy when so are at least one in this many: measured with noise of 0.2 to 10 % there were at most 2 in
    400 without outliers."""


@dataclass(frozen=True)
class InterpolationSettings:
    """When states are interpolated rather than smoothed."""

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
    quiet_share: float = 0.5
    """The same where only rows that change little tell that there is no noise: of fast transients the others err more
    by interpolation, too, than smoothing says."""
    end_rows: int = 4
    """Rows at each end of a trajectory whose derivatives by interpolation are much worse than the others'."""


@dataclass(frozen=True)
class HeldInputSettings:
    """How states are differentiated whose inputs are held between rows."""

    degrees: tuple[int, ...] = (1, 2, 3)
    """Of the polynomials in all variables that tell the errors of slopes; the one that leaves least is taken."""
    steps_per_term: int = 3
    """Steps for each term of a polynomial at least: of fifty steps the residual variance is known to a quarter then."""
    most_steps: int = 2000
    """Steps that a polynomial is fitted to: the error of a standard deviation is 1.6 % then."""
    most_noise: float = 0.5
    """Share of the variance of derivatives that errors may make up: where they are more than the motion, a smoother
    that crosses jumps tells more."""


@dataclass(frozen=True)
class QuantisationSettings:
    """When values count as multiples of a step."""

    fewest_values: int = 8
    """With fewer distinct values a step is chance as often as not, unless many rows repeat them."""
    written_steps: float = 3.0
    """Differences of at most so many steps of the last digit are those of writing numbers down."""
    shares_of_least: tuple[int, ...] = (1, 2, 3)
    """The step is the least difference of two values, or one of these shares of it."""
    improbable: float = 1e-6
    """Probability below which what is seen in many values, or between many rows, is not chance."""


@dataclass(frozen=True)
class ColumnSettings:
    """What columns say before anything is searched."""

    few_values: int = 8
    """With so many distinct values or fewer, an end of the range is one of the levels, and a relation of columns one of
    chance."""
    least_repeats: int = 2
    """Rows that hold a value which stands for a missing one: a measured one is not met twice so far out."""
    least_run: int = 3
    """Equal rows after another that are a stretch: two may be a turn that was rounded."""
    steep_steps: float = 10.0
    """Steps beside a clipped stretch are more than so many steps of the values. About a smooth turn a parabola stays
    within one of them for m rows and moves by 2.7 (m = 3) or less in the rows beside; a flat turn (of the fourth power)
    by 7."""
    most_clipped: int = 4
    """Where there are more than so many clipped values for each other one, nothing is left to go by."""
    most_compared: int = 100
    """Columns that are compared by least squares: time grows with their square."""
    rows_per_column: int = 10
    """Rows for each column of a relation that holds up to noise: with fewer, a pattern in residuals is not seen."""
    most_rows: int = 20_000
    """Rows over which sums are taken; of more, some that are spread evenly, or the first where neighbours count."""
    alike: float = 0.05
    """Residual of a relation that holds up to noise, as a share of the column's deviation, at most. With twice as much,
    2 of 563 drawn tables were said to have one that was the chance of slow motions: they left 6 and 8 %."""
    digits_read: int = 500
    """Values of a column whose digits are looked at."""
    least_rows: int = 30
    """Rows without which correlations and neighbours are not looked at."""
    significant: float = 3.0
    """Standard errors beyond which something counts as seen (p = 0.003)."""
    jumps: float = 0.75
    """Mean square steps over twice the variance from which on rows jump: a wave has fewer than five rows a period then,
    1 - cos(2 pi / 5) = 0.69."""
    followed: float = 0.1
    """Share of the variance of the next row that its neighbours leave, at most, if rows are steps of a map."""
    most_positions: int = 4
    """States for which neighbours are sought: of more, no row comes near another in their space and velocities."""
    least_window: int = 5
    """Rows of the shortest window with a curvature and something left."""
    most_windows: int = 400
    """Windows that are compared with each other: time grows with their square."""
    clear: float = 0.3
    """Noise of curvatures, as a share of their median size, below which they are compared. With half of it, of 128
    tables of full states one was taken for positions, with this none; of 128 of positions 71 were recognised."""
    near: float = 0.1
    """Distance of neighbours, in standard deviations of each coordinate."""
    least_pairs: int = 20
    """Pairs of neighbours without which nothing is said."""
    open_share: float = 0.5
    """Share of a variance that neighbours leave from which on something else decides."""
    closed_share: float = 0.1
    """Share of a variance that neighbours leave up to which nothing else decides."""


@dataclass(frozen=True)
class RowSettings:
    """Which rows the search is given."""

    most: int = 2_000
    """More rows than about this are thinned: a derivative rests on the measurements of many neighbours, and two
    thousand show every turn of a curve that a search can find."""
    over_median_uncertainty: float = 5.0
    """Rows whose uncertainty is less than this many times the median one are kept."""
    least_kept: float = 0.7
    """Share of the rows that is kept however uncertain they are, and that pieces between gaps must hold."""
    most_uneven: float = 2.0
    """Root mean square of the uncertainty over its mean, at most, on the rows selected."""
    most_divided: float = 0.1
    """Where rows are averaged, share of them, at most, that no state's mean has, because inputs change too fast."""


@dataclass(frozen=True)
class EffortSettings:
    """How much is tried. Work is counted by the estimator, see `MultipleShooting.work`."""

    work: int = 60_000_000
    """Work of each part of a selection, libraries, exchange and local search, after which it tries nothing new: some
    seconds of one core. What was begun may take as much again."""
    steps: int = 40
    """Most steps of a fit; nearly all settle within ten."""
    brief_steps: int = 6
    """Steps of a fit that only tells whether a candidate is worth more of them."""
    settled: float = 1e-7
    """A fit ends when a step lowers the cost by less than this share."""
    beam: int = 12
    """Alternatives, decisions, neighbours or members that stay where all cannot; constants that may be made simple."""
    kept: int = 48
    """Programs that stay for the next stage where there are hundreds."""

    @property
    def longest_sum(self) -> int:
        """Terms of the longest sum that is fitted again without each of them: that costs the square of their number."""
        return 2 * self.beam

    @property
    def rounds(self) -> Rounds:
        """Rounds by which many programs are narrowed down to a few: successive halving."""
        return (1, self.beam), (self.brief_steps, self.beam // 3), (self.steps, self.beam // 6)


@dataclass(frozen=True)
class SpreadSettings:
    """How work falls into batches that others may take."""

    batch: int = 2_500_000
    """Work of a batch of fits at most, about, as `MultipleShooting.work` counts: a tenth of a second, fifty times what
    giving it away takes. Where there are many workers batches are smaller."""
    constants: int = 4
    """Constants of an equation, about: a fit carries so many numbers along for each of its states."""
    steps: int = 8
    """Steps of a fit that may take more, about: most settle by then or earlier."""


@dataclass(frozen=True)
class CriterionSettings:
    """Prices of programs in nats: minus the logarithm of how often parts are met in equations of motion, about (compare
    the counts of Guimera et al. 2020 in a corpus of named equations)."""

    node: float = 2.0794415416798357
    """ln 8 for any node, where there are no trajectories: as if it were one of eight."""
    common: float = 1.4
    """A leaf, a sum, a product or a square of a system, and each further use of a part: one of four."""
    quotient: float = 2.1
    """One of eight."""
    function: float = 3.5
    """A sine, an exponential, a power with a constant exponent: one of thirty-two."""
    nested: float = 5.0
    """A function inside a function, beside the prices of both."""


@dataclass(frozen=True)
class RegressionSettings:
    """The equation of one variable on the rows of its target."""

    most_evaluations: int = 12_000_000
    """Point evaluations after which no new program is tried; those of a fit count with what it costs beside them."""
    denominators: tuple[int, ...] = (1, 2, 3, 4, 6)
    """Denominators of simple fractions."""
    rounding_reach: float = 4.0
    """Simple numbers are considered within so many standard errors of a constant."""
    numerators_beside: int = 2
    """Numerators on either side of the nearest that are considered."""
    pi_nats: float = 5.0
    """What it takes to say that a fraction is one of pi: more than two digits, lest short decimals are taken for
    one."""


@dataclass(frozen=True)
class SparseSettings:
    """Sparse sums of products by regression."""

    degree: int = 4
    """Highest degree of products: few laws have more, and libraries grow with its power."""
    largest_library: int = 130
    """Larger libraries are not tried: eliminating their terms costs the fourth power of their number."""
    rows_per_term: float = 2.0
    """Independent rows that each term of a library takes: with fewer, a full library fits anything."""
    most_rows: int = 20_000
    """Of more rows, stretches of a thousand stand for all: a law of a hundred products takes a few hundred windows."""
    stretch: int = 1_000
    smoothness: int = 4
    """Power of the test functions (1 - s^2)^p: the trapezoidal rule errs by its order in the step."""
    step: float = 0.25
    """Windows begin so many of their widths after the one before."""
    least_half: int = 5
    """Rows of half of the shortest window: nine rows count."""
    least_half_noise: float = 0.01
    """Noise, as a share of the deviation, from which on that one serves: by the trapezoidal rule a left side errs like
    one of a tenth of that (the transform of (1 - s^2)^4 at one wave a row)."""
    least_windows: int = 4
    """Half widths in the longest trajectory, at least."""
    pursued_rows: int = 256
    """About the rows that sums with functions are pursued on, less than twice as many: enough for some twenty terms."""
    most_shapes: int = 600
    """Larger dictionaries of products with functions are not tried: with all operators one of two states has up to
    214, of three 590."""
    pursued_functions: int = 2
    """Products with functions that are added."""
    pursued_constants: int = 7
    """Larger sums are no candidates."""
    reweightings: int = 3
    """Fits by which the weights of windows settle, each by the law of the one before."""


@dataclass(frozen=True)
class RateSettings:
    """Laws by regression on derivatives with errors of their own."""

    trusted_share: float = 0.4
    """Share of the rows, those known best, by which functions are found: of seven states with fast transients, 51 rows
    a run, the errors of that many were 1e-3 of the deviation, of seven in ten 0.3."""
    most_atoms: int = 40_000
    """Products with functions, one for each inner constant tried, that are compared: some seconds."""
    screened: int = 8
    """Variables that an equation is taken to have at most, where there are too many for a library of all products."""


@dataclass(frozen=True)
class WindowSettings:
    """Laws by regression on short windows with errors in all variables."""

    smoothness: int = 2
    """Power of the test functions (1 - s^2)^p: the least with a slope that vanishes at both ends."""
    least_half: int = 2
    """Half width in rows of the shortest windows: five rows, three of which count."""
    half_ratio: float = 1.5
    """Each half width tried over the one before."""
    resolved_share: float = 0.75
    """Windows get wider as long as in so many of them lines between rows serve as well as cubics, by the noise."""
    most: int = 2_000
    """Windows, about, beyond which some stand for all."""
    largest_library: int = 45
    """Larger libraries are not eliminated: all products of two of eight variables. Windows take its square."""
    turns: int = 4
    """Fits by which the errors of quadrature settle."""
    brief_rounds: int = 3
    """Steps of a fit on the way from a library to a short sum."""


@dataclass(frozen=True)
class ShootingSettings:
    """Fits of systems to trajectories by multiple shooting."""

    blow_up_widths: float = 3.0
    """A simulated state may leave the measured range by so many times its width before it counts as blown up."""
    exact: float = 1e-8
    """Errors below this share of a state's standard deviation are those of the integration, not of the model."""
    lengths: tuple[int, ...] = (10, 30, 100)
    """Rows of the segments by which a fit begins, of which short ones fit from anywhere, and of the pieces in which
    trajectories are simulated where errors of an initial state, or of a solver, grow too much along whole ones."""
    steps_per_row: int = 40
    """Integration steps that may be taken for each row, on average: what needs more is stiff or blows up."""
    segment_growth: int = 5
    """Segments grow at most so many times from one stage of a fit to the next, and the longest to whole pieces."""

    @property
    def piece(self) -> int:
        """Most rows of a trajectory that are simulated at a stretch: the misfit of longer ones has many minima."""
        return self.segment_growth * self.lengths[-1]


@dataclass(frozen=True)
class SelectionSettings:
    """Which equations together are the model. Work is counted by the estimator, see `MultipleShooting.work`."""

    least_noise: float = 1e-4
    """Independent errors below this share of a state's standard deviation cannot hide a term of a law: whatever is
    left then are systematic errors, of a solver for instance, for which rows do not count one by one."""
    usual_length: float = 30.0
    """Nats of an equation's structure and constants: four of five of the 174 laws that `benchmarks.corpus --in-turn
    --seeds 1600-1628` draws take less (22 in the median, 2.5 nats a constant). Behind a longer equation there may be a
    short law that was not proposed, however little it leaves."""
    systematic_numbers: float = 10.0
    """How many independent numbers systematic errors of a state are at least, and a solver's that are smaller than
    that: few, since they follow from its tolerance and the state. Each decade less is worth so many times 1.15 nats: a
    law whose terms are needed gains several decades, one that follows the solver's errors less than a third."""
    solver_share: float = 0.25
    """What constants leave of a few rows, over the errors of a solver there, beyond which that is not tried any longer:
    0.1 were seen where it is the one, mostly more where it is not. All rows are asked for a thousandth."""
    solver_constants: float = 0.01
    """Relative error of constants that are fitted to short pieces of a table with a solver's errors, about."""
    least_folds: int = 3
    """With fewer trajectories, too little is left to fit constants to."""
    compared_numbers: int = 7_200
    """Structures of many states are compared on at most about so many numbers, rows times states: the work of a row
    grows with the square of the states and more, and each row tells as much about each equation."""
    fitted_sensitivities: int = 1_500_000
    """Constants of many states are fitted to at most so many rows times the square of the states: the sensitivities of
    a row to the states at its beginning. That is 900 rows of 40 states, and more rows than a search is given of 20."""
    compared_rows: int = 1_200
    """Structures are compared on at most about so many rows; constants are then fitted on all."""
    tolerated_noise: float = 0.01
    """Share of the noise that an integration step may err by, within `tolerances`."""
    least_gain: float = 0.1
    """Nats by which descriptions must differ to count."""


@dataclass(frozen=True)
class InferenceSettings:
    """What is said of the model: errors of constants, residuals, verdicts."""

    lags: int = 3
    """Rows this far apart are compared; a model that misses something errs the same way for several rows."""
    exact: float = 1e-6
    """Residuals below this share of the standard deviation are those of the integration."""
    excess: float = 1.25
    """Residuals this many times as large as the noise are too large, unless they may be so by chance."""
    part: float = 0.1
    """Share of a variance, or of a measured range, that is worth a word: followed by a pattern, not explained, or left
    by a simulation; what explains less is no model."""
    improbable: float = 0.01
    """Probability below which residuals are not those of noise."""
    largest_uncertainty: float = 0.01
    """A target that is more uncertain cannot tell a law from nonsense of the same error; trajectories can."""
    chance_nats: float = 4.6
    """What is described so much better by an equation than by none is no chance (odds of 100: of equations called good
    one in a hundred may be wrong)."""
    exact_nats: float = 5.3
    """What is not this much longer as a description may be the law in place of an exact one (odds of 200: an exact
    verdict may be wrong in one of two hundred)."""
    distinct_nats: float = 3.0
    """What is not this much longer as a description may be right (odds of 20, as a good verdict may be wrong in one of
    twenty)."""


@dataclass(frozen=True)
class ProcessSettings:
    """Stochastic processes, whose noise is part of the law."""

    fewest_steps: int = 100
    """Steps from row to row without which no process is sought: a variance is known to 14 % then."""
    least_noise: float = 1e-4
    """Share of the median step that noise has at least: with less, the equations are those of a process without."""
    significant: float = 3.0
    """Standard errors beyond which measurement noise, and a correlation between states, count as seen (p = 0.003)."""
    bins: int = 512
    """Bins of steps by which candidates are fitted: enough to decide some twenty terms of two or three states."""
    compared: int = 8
    """Candidates of regression that the likelihood compares: it moves them by nats, regression has ranked them."""
    rounds: int = 4
    """Most passes over all equations; nearly all end after the second, which changes nothing."""
    relinearisations: int = 2
    """Times that a process is linearised about states smoothed by itself, after which its constants move by less than
    a hundredth of their standard errors."""
    settled: float = 1e-3
    """Nats: a fit of the likelihood ends when a step gains less, a hundredth of what counts in a description."""


@dataclass(frozen=True)
class Settings:
    """The numbers of all stages: preparing data, then choosing the model."""

    common: CommonSettings = CommonSettings()
    checks: CheckSettings = CheckSettings()
    smoothing: SmoothingSettings = SmoothingSettings()
    robustness: RobustnessSettings = RobustnessSettings()
    interpolation: InterpolationSettings = InterpolationSettings()
    held_inputs: HeldInputSettings = HeldInputSettings()
    quantisation: QuantisationSettings = QuantisationSettings()
    columns: ColumnSettings = ColumnSettings()
    rows: RowSettings = RowSettings()
    effort: EffortSettings = EffortSettings()
    spread: SpreadSettings = SpreadSettings()
    criterion: CriterionSettings = CriterionSettings()
    regression: RegressionSettings = RegressionSettings()
    sparse: SparseSettings = SparseSettings()
    rates: RateSettings = RateSettings()
    windows: WindowSettings = WindowSettings()
    shooting: ShootingSettings = ShootingSettings()
    selection: SelectionSettings = SelectionSettings()
    inference: InferenceSettings = InferenceSettings()
    process: ProcessSettings = ProcessSettings()


VARIABLE: Final = "ATOLL_TRY_SETTINGS"
"""Variable of the environment with other values, such as ``selection.least_gain=0.2 effort.steps=80``: for measurements
of what a number changes (``benchmarks.pools settings``). Results with other values are not those of this engine."""


def with_changes(settings: Settings, text: str) -> Settings:
    """Return settings with other values, ``STAGE.NAME=VALUE`` separated by spaces.

    Raises:
        ValueError: There is no such setting, or the value is of another kind.
    """
    for word in text.split():
        name, _, value = word.partition("=")
        stage_name, _, field = name.partition(".")
        stage: Any = getattr(settings, stage_name, None)
        if stage_name not in vars(settings) or field not in vars(stage):
            raise ValueError(f"{VARIABLE} has {word!r}, but there is no setting {name!r}; write STAGE.NAME=VALUE")
        changed = ast.literal_eval(value)
        if type(changed) is not type(vars(stage)[field]):
            raise ValueError(f"{VARIABLE} has {word!r}, but {name} is a value such as {vars(stage)[field]}")
        changed_stage: Any = replace(stage, **{field: changed})
        settings = replace(settings, **{stage_name: changed_stage})
    return settings


SETTINGS: Final = with_changes(Settings(), os.environ.get(VARIABLE, ""))
"""The values in use."""
