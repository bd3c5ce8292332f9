"""All hand-set numbers that decide which equation is shown and its verdict, by stage, with their reasons.

Other numbers stand where they are used: numbers of presentation, mathematical constants, guards against division by
zero, the sizes of compiled kernels and the numerics of minimisers and integrators.
"""

import ast
import logging
import os
from dataclasses import dataclass, replace
from typing import Any, Final

Rounds = tuple[tuple[int, int], ...]
"""Rounds of a comparison: for each, the steps of a fit and the number of systems that are kept."""


@dataclass(frozen=True)
class CommonSettings:
    """Numbers of more than one stage; shares are of a state's or a derivative's standard deviation."""

    negligible: float = 1e-3
    """A share that is too small to matter."""
    clean: float = 1e-5
    """Noise or uncertainty below this share counts as zero: bias and rounding of noise-free data are about as large."""


@dataclass(frozen=True)
class CheckSettings:
    """Requirements on measurements before anything is computed from them."""

    min_rows: int = 5
    """Fewest rows of a trajectory that has a derivative, of a span, and of any search: a cubic and one to judge it."""
    smallest: float = 1e-150
    """Guard: numbers below this, or above its inverse, have a square that under- or overflows."""
    by_chance: float = 0.01
    """Probability, at most, that jumps are as near to a full turn by chance where a column is treated as an angle."""


@dataclass(frozen=True)
class SmoothingSettings:
    """How span, degree and thinning of loess are selected."""

    degrees: tuple[int, ...] = (3, 4)
    """Degrees tried. A parabola may fit the values as well as a cubic, but its slope has far more bias: the measured
    derivative error was up to 2.8 times the standard error with parabolas and up to 1.9 times without."""
    span_ratio: float = 1.25
    """Ratio of each span tried to the previous one."""
    patience: int = 5
    """Spans without a better score after which wider ones are not tried."""
    least_bins_in_span: int = 40
    """Bins in the narrowest span for which rows may be thinned: means over a fortieth of a span lose nothing."""
    narrower: float = 0.6
    """The bias of a derivative is estimated from a second derivative, whose span is this many times as wide."""


@dataclass(frozen=True)
class RobustnessSettings:
    """How outliers are recognised (Cleveland 1979, section 2)."""

    rounds: int = 6
    """Most rounds of reweighting rows by the residuals of the previous round; nearly all fits settle earlier."""
    reach: float = 6.0
    """Residuals larger than this many times the median residual have no weight (Cleveland 1979)."""
    isolated: float = 0.5
    """An outlier's neighbours have at most this share of its residual; at an unresolved jump they have more."""
    fewest: int = 3
    """Tails are heavy if at least this many residuals are isolated and far out: fewer may be chance."""
    rows_per_outlier: int = 150
    """Tails are heavy if at least one row in this many is such an outlier. Tables without outliers and with noise of
    0.2 to 10 % had at most 2 in 400."""


@dataclass(frozen=True)
class InterpolationSettings:
    """When states are interpolated rather than smoothed."""

    largest_noise: float = 3e-4
    """Noise, as a share of the state's standard deviation, beyond which data are never interpolated."""
    smallest_noise: float = 1e-9
    """Noise, as a share of the state's standard deviation, below which data count as noise-free."""
    agreement: float = 2.0
    """Estimates of the noise by two stencils agree if they differ by at most this many standard errors. In simulations
    of pure noise (even and uneven steps, 50 to 1,000 rows) the mean estimate is 1.03 to 1.09 times the truth."""
    judged_shares: tuple[float, ...] = (0.95, 0.75)
    """Shares of the rows, best rows first, on which interpolation and smoothing are compared: neither jumps nor rows at
    rest may decide. Without noise interpolation wins on one share at least; with noise it loses on both, by a factor
    near 1.5."""
    quiet_share: float = 0.5
    """The same share if only rows that change little show that there is no noise: on fast transients the errors of
    interpolation are larger than smoothing estimates."""
    end_rows: int = 4
    """Rows at each end of a trajectory whose interpolated derivatives are much worse than those of other rows."""


@dataclass(frozen=True)
class HeldInputSettings:
    """Derivatives of states whose inputs are held between rows."""

    degrees: tuple[int, ...] = (1, 2, 3)
    """Degrees of the polynomials in all variables that estimate the errors of slopes; the best fit is used."""
    steps_per_term: int = 3
    """Fewest steps for each term of a polynomial: fifty steps then give the residual variance within a quarter."""
    most_steps: int = 2000
    """Most steps that a polynomial is fitted to: the error of a standard deviation is then 1.6 %."""
    most_noise: float = 0.5
    """Largest share of errors in the variance of derivatives: if errors exceed the motion, a smoother that ignores
    jumps is more precise."""


@dataclass(frozen=True)
class QuantisationSettings:
    """Whether values count as multiples of a step."""

    fewest_values: int = 8
    """With fewer distinct values a step is often chance, unless many rows repeat the values."""
    written_steps: float = 3.0
    """Differences of at most this many steps of the last digit are rounding in writing."""
    shares_of_least: tuple[int, ...] = (1, 2, 3)
    """The step is the least difference of two values, or one of these shares of it."""
    improbable: float = 1e-6
    """Probability below which a pattern in many values, or between many rows, is not chance."""


@dataclass(frozen=True)
class ColumnSettings:
    """Findings about columns before the search."""

    few_values: int = 8
    """With this many distinct values or fewer, an end of the range is one of the levels, and a relation of columns is
    chance."""
    least_repeats: int = 2
    """Fewest rows with a placeholder of missing values: a measured value so far out does not repeat."""
    least_run: int = 3
    """Fewest equal rows in sequence that count as clipped: two may be a rounded turning point."""
    steep_steps: float = 10.0
    """Next to clipped rows the column moves by more than this many steps of its values. At a smooth turning point a
    parabola stays within one step for m rows and moves by at most 2.7 steps (m = 3) in the next rows; a flat turning
    point (fourth power) moves by 7."""
    most_clipped: int = 4
    """Most clipped values for each value that is not clipped: with more, too little of the column is known."""
    most_compared: int = 100
    """Most columns that are compared by least squares: time grows with the square of their number."""
    rows_per_column: int = 10
    """Fewest rows for each column of a relation that holds up to noise: with fewer, patterns in residuals are not
    seen."""
    most_rows: int = 20_000
    """Most rows in sums; of more rows an evenly spread subset is used, or the first rows where neighbours matter."""
    alike: float = 0.05
    """Residual of a relation that holds up to noise, at most, as a share of the column's standard deviation. With twice
    as much, chance relations of slow motions were reported in 2 of 563 drawn tables (residuals of 6 and 8 %)."""
    digits_read: int = 500
    """Most values of a column whose digits are examined."""
    least_rows: int = 30
    """Fewest rows for which correlations and neighbours are examined."""
    significant: float = 3.0
    """Standard errors beyond which a finding is significant (p = 0.003)."""
    jumps: float = 0.75
    """Mean square step over twice the variance from which on rows jump: a wave then has fewer than five rows in a
    period (1 - cos(2 pi / 5) = 0.69)."""
    followed: float = 0.1
    """Largest unexplained share of the variance of the next row, predicted from neighbours, if rows are steps of a
    map."""
    most_positions: int = 4
    """Most states for which neighbours are sought: with more, no rows are near each other in positions and
    velocities."""
    least_window: int = 5
    """Rows of the shortest window with a curvature and residuals."""
    most_windows: int = 400
    """Most windows that are compared with each other: time grows with the square of their number."""
    clear: float = 0.3
    """Noise of curvatures, as a share of their median size, below which they are compared. Of 128 tables of
    full states none was mistaken for positions (with half this value, one); of 128 tables of positions 71 were
    recognised."""
    near: float = 0.1
    """Distance of neighbours, in standard deviations of each coordinate."""
    least_pairs: int = 20
    """Fewest pairs of neighbours for a finding."""
    open_share: float = 0.5
    """Share of the variance unexplained by neighbours from which on another variable must matter."""
    closed_share: float = 0.1
    """Share of the variance unexplained by neighbours up to which no other variable matters."""


@dataclass(frozen=True)
class RowSettings:
    """Rows of the search."""

    most: int = 2_000
    """About the most rows; more are thinned. A derivative uses the measurements of many neighbours, and two thousand
    rows show every turn of a curve that a search can find."""
    over_median_uncertainty: float = 5.0
    """Rows whose uncertainty is less than this many times the median uncertainty are kept."""
    least_kept: float = 0.7
    """Share of the rows that is kept regardless of uncertainty, and that pieces between gaps must contain."""
    most_uneven: float = 2.0
    """Root mean square of the uncertainty over its mean, at most, on the rows selected."""
    most_divided: float = 0.1
    """Largest share of averaged rows that are in no mean, because inputs change too fast."""


@dataclass(frozen=True)
class EffortSettings:
    """Amounts of work, in the unit of `MultipleShooting.work`."""

    work: int = 60_000_000
    """Work of each part of a selection (libraries, exchange, local search) after which it tries nothing new: some
    seconds of one core. Fits that have begun may take as much again."""
    steps: int = 40
    """Most steps of a fit; nearly all converge within ten."""
    brief_steps: int = 6
    """Steps of a short fit, which decides whether a candidate gets a full fit."""
    settled: float = 1e-7
    """A fit ends when a step lowers the cost by less than this share."""
    beam: int = 12
    """Number of alternatives, decisions, neighbours or members that are kept, and of constants that may become
    simple."""
    kept: int = 48
    """Programs kept for the next stage if there are hundreds."""

    @property
    def evaluations(self) -> int:
        """Point evaluations of the fits to one target after which no new program is tried."""
        return self.work // 5

    @property
    def longest_sum(self) -> int:
        """Terms of the longest sum that is fitted again without each term: the work grows with the square of their
        number."""
        return 2 * self.beam

    @property
    def rounds(self) -> Rounds:
        """Rounds by which many programs are narrowed down to a few: successive halving."""
        return (1, self.beam), (self.brief_steps, self.beam // 3), (self.steps, self.beam // 6)


@dataclass(frozen=True)
class SpreadSettings:
    """Division of work into batches for other workers."""

    batch: int = 2_500_000
    """About the most work of a batch of fits, as `MultipleShooting.work` counts it: a tenth of a second, fifty times
    the time of sending it. With many workers batches are smaller."""
    constants: int = 4
    """Typical number of constants of an equation: a fit integrates this many sensitivities for each of its states."""
    steps: int = 8
    """Typical number of steps of a fit: most converge within these."""


@dataclass(frozen=True)
class CriterionSettings:
    """Prices of programs in nats: about minus the logarithm of the frequency of parts in equations of motion (compare
    the counts of Guimera et al. 2020 in a corpus of named equations)."""

    node: float = 2.0794415416798357
    """Without trajectories, any node costs ln 8: one of eight choices."""
    common: float = 1.4
    """A leaf, a sum, a product or a square, and each further use of a part: one of four choices."""
    quotient: float = 2.1
    """A quotient: one of eight choices."""
    function: float = 3.5
    """A sine, an exponential, a power with a constant exponent: one of thirty-two choices."""
    nested: float = 5.0
    """A function inside a function, in addition to the prices of both."""


@dataclass(frozen=True)
class SparseSettings:
    """Sparse sums of products by regression."""

    degree: int = 4
    """Highest degree of products: few laws have more, and libraries grow with its power."""
    largest_library: int = 130
    """Larger libraries are not tried: eliminating their terms costs the fourth power of their number."""
    rows_per_term: float = 2.0
    """Fewest independent rows for each term of a library: with fewer, a full library fits anything."""
    most_rows: int = 20_000
    """Larger tables are subsampled in blocks of `stretch` rows: a law of a hundred products needs a few hundred
    windows."""
    stretch: int = 1_000
    smoothness: int = 4
    """Power of the test functions (1 - s^2)^p: the trapezoidal rule errs by its order in the step."""
    step: float = 0.25
    """Distance of successive windows over their width."""
    least_half: int = 5
    """Rows of half of the shortest window: nine rows count."""
    least_half_noise: float = 0.01
    """Noise, as a share of the standard deviation, from which on the shortest window is used: the errors of a left side
    by the trapezoidal rule are a tenth of this (the transform of (1 - s^2)^4 at one wave per row)."""
    least_windows: int = 4
    """Fewest half widths in the longest trajectory."""
    pursued_rows: int = 256
    """Rows of a pursuit of sums with functions, up to twice as many: enough for some twenty terms."""
    most_shapes: int = 600
    """Larger dictionaries of products with functions are not tried: with all operators a dictionary of two states
    has up to 214 terms, of three states 590."""
    pursued_functions: int = 2
    """Most products with functions that are added."""
    pursued_constants: int = 7
    """Sums with more constants are not candidates."""
    reweightings: int = 3
    """Fits until the weights of windows settle; each uses the weights of the law before."""


@dataclass(frozen=True)
class RateSettings:
    """Laws by regression on derivatives with known errors."""

    trusted_share: float = 0.4
    """Share of the rows, most certain first, in which functions are sought: for seven states with fast transients and
    51 rows a trajectory, their errors were 1e-3 of the standard deviation; with a share of 0.7 they were 0.3."""
    most_atoms: int = 40_000
    """Products with functions, one for each inner constant tried, that are compared: some seconds of work."""
    screened: int = 8
    """Most variables of an equation, if there are too many variables for a library of all products."""


@dataclass(frozen=True)
class WindowSettings:
    """Laws by regression on short windows with errors in all variables."""

    smoothness: int = 2
    """Power of the test functions (1 - s^2)^p: the smallest whose slope vanishes at both ends."""
    least_half: int = 2
    """Half width in rows of the shortest windows: five rows, three of which count."""
    half_ratio: float = 1.5
    """Ratio of each half width tried to the previous one."""
    resolved_share: float = 0.75
    """Windows get wider as long as, in this share of them, lines between rows are as good as cubics within the
    noise."""
    most: int = 2_000
    """About the most windows; of more a subset is used."""


@dataclass(frozen=True)
class ShootingSettings:
    """Fits of systems to trajectories by multiple shooting."""

    blow_up_widths: float = 3.0
    """A simulated state may leave the measured range by this many times its width before it counts as blown up."""
    exact: float = 1e-8
    """Errors below this share of a state's standard deviation are integration errors, not errors of the model."""
    lengths: tuple[int, ...] = (10, 30, 100)
    """Rows of the first segments of a fit (short ones converge from any guess), and of the pieces in which trajectories
    are simulated if errors of an initial state, or of a solver, grow too much along whole trajectories."""
    steps_per_row: int = 40
    """Most integration steps for each row, on average: systems that need more are stiff or blow up."""
    segment_growth: int = 5
    """Segments grow at most by this factor from one stage of a fit to the next, and the longest to whole pieces."""

    @property
    def piece(self) -> int:
        """Most rows of a trajectory that are simulated without a break: the misfit of longer pieces has many minima."""
        return self.segment_growth * self.lengths[-1]


@dataclass(frozen=True)
class SelectionSettings:
    """Which equations together are the model. Work is counted by the estimator, see `MultipleShooting.work`."""

    least_noise: float = 1e-4
    """Independent errors below this share of a state's standard deviation cannot hide a term of a law: the
    residuals are then systematic errors, for instance of a solver, whose rows are not independent."""
    usual_length: float = 30.0
    """Nats of an equation's structure and constants: four of five of the 174 laws that `benchmarks.corpus --in-turn
    --seeds 1600-1628` draws take less (22 in the median, 2.5 nats a constant). If an equation is longer, there may be
    a short law that was not proposed, however small its residuals."""
    systematic_numbers: float = 10.0
    """Fewest independent numbers in the systematic errors of a state, and the number for errors of a solver: few, since
    these follow from its tolerance and the state. A misfit smaller by a decade gains 1.15 nats for each number: needed
    terms of a law gain several decades, a term that follows a solver's errors less than a third of one."""
    solver_share: float = 0.25
    """Residuals of a few rows over the errors of a solver there, beyond which this solver is given up: for the right
    solver 0.1 was observed, for others mostly more. On all rows the limit is a thousandth."""
    solver_constants: float = 0.01
    """Typical relative error of constants fitted to short pieces of a table with a solver's errors."""
    least_folds: int = 3
    """Fewest trajectories for leaving one out: with fewer, too few rows remain to fit constants to."""
    compared_numbers: int = 7_200
    """Structures of many states are compared on at most about this many numbers, rows times states: the work of a row
    grows at least with the square of the number of states, and each row has information on every equation."""
    fitted_sensitivities: int = 1_500_000
    """Constants of many states are fitted to at most this many rows times the square of the number of states (the
    sensitivities of a row to its initial states): 900 rows of 40 states; with 20 states, all rows of a search."""
    compared_rows: int = 1_200
    """Structures are compared on at most about this many rows; constants are then fitted on all."""
    tolerated_noise: float = 0.01
    """Largest error of an integration step as a share of the noise, within `tolerances`."""
    least_gain: float = 0.1
    """Smallest difference of description lengths that counts, in nats."""


@dataclass(frozen=True)
class InferenceSettings:
    """Inference on the model: errors of constants, residuals, verdicts."""

    lags: int = 3
    """Rows up to this far apart are compared; the residuals of a model that lacks a term have the same sign for several
    rows."""
    exact: float = 1e-6
    """Residuals below this share of the standard deviation are integration errors."""
    excess: float = 1.25
    """Residuals larger than this many times the noise are too large, unless they may be by chance."""
    part: float = 0.1
    """Share of a variance, or of a measured range, that is relevant: a pattern in residuals, unexplained variance, or a
    simulation outside of the range. An equation that explains less is not a model."""
    improbable: float = 0.01
    """Probability below which residuals are not noise."""
    largest_uncertainty: float = 0.01
    """A target that is more uncertain does not distinguish a law from wrong equations of the same error."""
    chance_nats: float = 4.6
    """Δ log-likelihood over no equation from which on an equation is not chance (odds of 100: one in a hundred good
    equations may be wrong)."""
    exact_nats: float = 5.3
    """Alternatives within this Δ description length may be the law instead of an exact equation (odds of 200: one in
    two hundred exact verdicts may be wrong)."""
    distinct_nats: float = 3.0
    """Alternatives within this Δ description length may be right (odds of 20: one in twenty good verdicts may be
    wrong)."""
    denominators: tuple[int, ...] = (1, 2, 3, 4, 6)
    """Denominators of simple fractions."""


@dataclass(frozen=True)
class ProcessSettings:
    """Stochastic processes, whose noise is part of the law."""

    fewest_steps: int = 100
    """Fewest steps from row to row for which a process is sought: they give a variance within 14 %."""
    least_noise: float = 1e-4
    """Least noise as a share of the median step: with less, the process counts as deterministic."""


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
    sparse: SparseSettings = SparseSettings()
    rates: RateSettings = RateSettings()
    windows: WindowSettings = WindowSettings()
    shooting: ShootingSettings = ShootingSettings()
    selection: SelectionSettings = SelectionSettings()
    inference: InferenceSettings = InferenceSettings()
    process: ProcessSettings = ProcessSettings()


VARIABLE: Final = "ATOLL_TRY_SETTINGS"
"""Environment variable with other values, such as ``selection.least_gain=0.2 effort.steps=80``, to measure the effect
of a setting (``benchmarks.pools settings``). With it, results differ from the results of this engine."""


def with_changes(settings: Settings, text: str) -> Settings:
    """Return settings with other values, ``STAGE.NAME=VALUE`` separated by spaces.

    Raises:
        ValueError: There is no such setting, or the value has another type.
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


_CHANGES: Final = os.environ.get(VARIABLE, "")
if _CHANGES:
    logging.getLogger(__name__).warning("%s is set (%s): results are not those of this engine", VARIABLE, _CHANGES)

SETTINGS: Final = with_changes(Settings(), _CHANGES)
"""The values in use."""
