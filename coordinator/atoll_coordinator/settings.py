"""Every number set by hand that decides which equation is shown and what is said of it, by stage, with its reason.

Numbers of presentation stand where they are used, and so do mathematical constants, guards against division by zero,
the sizes of compiled kernels and the numerics of minimisers and integrators.
"""

from dataclasses import dataclass
from typing import Final

Rounds = tuple[tuple[int, int], ...]
"""How a comparison is narrowed down: in each round the steps of a fit, and how many systems stay."""

Lengths = tuple[int | None, ...]
"""Rows of the segments of a fit, stage by stage; None: whole pieces."""


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
    jump_over_neighbours: float = 3.0
    """A jump of a wrapped angle is this many times as large as the steps beside it, and differs from a turn by at
    most as many of them."""


@dataclass(frozen=True)
class TrajectorySettings:
    """How times are taken."""

    time_rounding: float = 4.0
    """Times are even when they are so within this many units in the last place of the largest one, and steps are this
    many times as long as that."""


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
    end_rows: int = 4
    """Rows at each end of a trajectory whose derivatives by interpolation are much worse than the others'."""


@dataclass(frozen=True)
class QuantisationSettings:
    """When values count as multiples of a step."""

    fewest_values: int = 8
    """With fewer distinct values a step is chance as often as not."""
    written_steps: float = 3.0
    """Differences of at most so many steps of the last digit are those of writing numbers down."""
    shares_of_least: tuple[int, ...] = (1, 2, 3)
    """The step is the least difference of two values, or one of these shares of it."""
    improbable: float = 1e-6
    """Probability below which what is seen in many values, or between many rows, is not chance."""


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


@dataclass(frozen=True)
class StructureSettings:
    """Structural moves: libraries of terms, extensions, neighbours, reductions."""

    largest_library: int = 24
    """Larger libraries of terms are not tried: their elimination costs the square of their size."""
    new_part_size: float = 1e-3
    """Size of a new part beside what it is joined to: the fit begins near the old equation."""
    extension_factor: float = 1.0001
    """A new factor that is going to be fitted; exactly one would not stay."""
    neighbour_factor: float = 1.001
    """A new factor of a neighbour, which leaves the program nearly as it is."""
    neighbour_summand: float = 0.001
    """A new summand of a neighbour, which leaves the program nearly as it is."""
    fresh_constant: float = 1.5
    """A constant that is going to be fitted and has no old value; a neutral one would not stay."""


@dataclass(frozen=True)
class RegressionSettings:
    """The equation of one variable on the rows of its target."""

    rows_at_a_time: int = 100_000
    """Rows that are evaluated at a time, to save memory."""
    fit_steps: int = 40
    """Most steps of a fit; nearly all settle within ten."""
    overhead_rows: int = 500
    """Rows whose evaluation takes as long as everything else about a program."""
    first_damping: float = 1e-3
    """Marquardt's damping of the first step."""
    least_damping: float = 1e-12
    """Below, a step is Newton's."""
    most_damping: float = 1e8
    """A fit whose steps all fail up to here ends."""
    settled: float = 1e-6
    """A fit ends when a step lowers the mean squared error by less than this share."""
    steps_before_giving_up: int = 7
    """Steps after which a fit that is not going to come near what is asked is given up."""
    beam: int = 12
    """Partial decisions on simple constants that are kept at each step."""
    decisions_measured: int = 12
    """Decisions on simple constants that are fitted and measured."""
    simple_odds: float = 20.0
    """Odds against all other numbers from which a simple one takes the place of an estimate: those of
    `InferenceSettings.distinct_nats`."""
    most_rounded_constants: int = 12
    """Equations with more constants stay as fitted."""
    numbers_per_constant: int = 8
    """Simple numbers that are tried for one constant."""
    front_margin: float = 40.0
    """Front members whose description is longer than the shortest by more nats are left out."""
    neighbour_margin: float = 6.0
    """Neighbours are rounded whose description, constants as fitted, is longer than the best by at most so many
    nats."""
    simple_margin: float = 20.0
    """The smallest model that is at most so many nats longer than the shortest has its neighbours tried, too."""
    most_members: int = 10
    """Front members that are shortened."""
    most_neighbours: int = 12
    """Neighbours of an equation that are rounded."""
    most_evaluations: int = 12_000_000
    """Point evaluations after which no new program is tried; those of a fit count with what it costs beside them."""
    shortening_steps: int = 40
    """Most steps of the fit of a program that is kept."""
    trial_steps: int = 25
    """Most steps of the fit of a program that is only tried."""
    denominators: tuple[int, ...] = (1, 2, 3, 4, 6)
    """Denominators of simple fractions."""
    most_digits: int = 15
    """Digits of a decimal, at most: those of a double."""
    rounding_reach: float = 4.0
    """Simple numbers are considered within so many standard errors of a constant."""
    numerators_beside: int = 2
    """Numerators on either side of the nearest that are considered."""
    pi_nats: float = 5.0
    """What it takes to say that a fraction is one of pi: more than two digits, lest short decimals are taken for
    one."""
    most_of_pi: int = 24
    """Larger numerators of multiples of pi are not considered."""
    compared_rows: int = 2_000
    """Structures are compared on at most so many rows, spread evenly; constants are then decided on more."""
    deciding_rows: int = 100_000
    """Rows on which constants are decided, at most."""
    attempts: int = 4
    """Shortest models that are finished until one may be shown."""


@dataclass(frozen=True)
class SparseSettings:
    """Sparse sums of products by regression."""

    degree: int = 4
    """Highest degree of products: few laws have more, and libraries grow with its power."""
    largest_library: int = 130
    """Larger libraries are not tried: eliminating their terms costs the fourth power of their number."""
    rows_per_term: float = 2.0
    """Independent rows that each term of a library takes: with fewer, a full library fits anything."""
    smoothness: int = 4
    """Power of the test functions (1 - s^2)^p: the trapezoidal rule errs by its order in the step."""
    step: float = 0.25
    """Windows begin so many of their widths after the one before."""
    least_half: int = 8
    """Rows of half a window, at least: fewer integrate with errors beyond the noise."""
    least_windows: int = 4
    """Half widths in the longest trajectory, at least."""
    pursued_rows: int = 256
    """Rows that sums with functions are pursued on: enough to decide some twenty terms."""
    pursued_degree: int = 3
    """Highest degree of the polynomial that functions are added to; products with functions have one less."""
    most_shapes: int = 600
    """Larger dictionaries of products with functions are not tried: one of two states has about 300."""
    pursued_functions: int = 2
    """Products with functions that are added."""
    pursued_beam: int = 16
    """Sums that go on when a term is added; twice as many are fitted."""
    pursued_constants: int = 7
    """Larger sums are no candidates."""
    pursued_kept: int = 8
    """Sums of each number of constants that are candidates."""
    reweightings: int = 3
    """Fits by which the weights of windows settle, each by the law of the one before."""


@dataclass(frozen=True)
class ShootingSettings:
    """Fits of systems to trajectories by multiple shooting."""

    least_eigenvalue: float = 1e-11
    """Smaller eigenvalues of the normal matrix with a unit diagonal are those of rounding."""
    open_loading: float = 1e-6
    """Squared component of a constant along a direction that is not determined, from which it is not determined
    itself."""
    cancelled: float = 1e-13
    """Share of its diagonal that rounding leaves of the normal matrix where initial states stand in for a constant."""
    cache_bytes: int = 64_000_000
    """Fits that are remembered take about so much together; beyond, the oldest go."""
    blow_up_widths: float = 3.0
    """A simulated state may leave the measured range by so many times its width before it counts as blown up."""
    piece: int = 500
    """Rows of a trajectory that are simulated at a stretch; the misfit of longer ones has too many minima to be
    fitted."""
    least_piece: int = 100
    """Where there are many rows, pieces of so many are compared rather than shorter ones of more trajectories."""
    steps_per_row: int = 40
    """Integration steps that may be taken for each row, on average: what needs more is stiff or blows up."""
    quick_steps_per_row: int = 8
    """The same for the quick method: beyond, implicit steps take less time."""
    finest_implicit: float = 1e-6
    """Errors of an implicit step, over a state's standard deviation, are not made smaller: its order is low."""
    free_steps: tuple[float, float, float] = (4.0, 12.0, 1.0)
    """Steps for each row that do not count as more work, by the quick, the precise and the implicit method."""
    quick_enough: float = 1e-5
    """Errors of a step, over a state's standard deviation, above which the quick method takes less time."""
    overhead_numbers: int = 10
    """Numbers whose carrying along takes as long as everything else about a row."""
    brief_steps: int = 6
    """Steps of a fit that only tells whether a candidate is worth more of them."""
    segment_growth: int = 5
    """Segments grow at most so many times from one stage of a fit to the next."""
    fit_bytes: int = 8_000
    """What a remembered fit takes beside its states and residuals."""
    settled: float = 1e-7
    """A fit ends when a step lowers the cost by less than this share."""
    first_damping: float = 1e-3
    """Marquardt's damping of the first step."""
    most_damping: float = 1e9
    """A fit whose steps all fail up to here ends."""
    least_noise: float = 1e-9
    """Noise that errors are weighted by, over a state's standard deviation, at least."""
    steepest: float = 1e60
    """Sensitivities beyond this have no squares to compute with."""


@dataclass(frozen=True)
class SelectionSettings:
    """Which equations together are the model. Work is counted by the estimator, see `MultipleShooting.work`."""

    alternatives: int = 8
    """Alternative equations of a variable that are reported, at most."""
    validated_nats: float = 6.0
    """Alternatives that are not more nats behind are cross-validated."""
    validated: int = 5
    """Alternatives of a variable that are cross-validated, at most."""
    undecided_nats: float = 3.0
    """Alternatives that are not more nats behind take the first place if they predict better."""
    clearly_better_nats: float = 3.0
    """Nats by which they must predict better: a needless constant gains or loses one or two by chance."""
    same_function: float = 1e-3
    """Equations whose values differ by less than this share of their standard deviation, root mean square, are the
    same."""
    alternative_rounds: Rounds = ((12, 24),)
    """Rounds by which alternatives are fitted."""
    kept_candidates: int = 60
    """Candidates of which longer segments are fitted, the best by short ones."""
    library_work: int = 150_000_000
    """Work after which no other libraries are tried; hundreds of rows take a few tenths of it."""
    regression_steps: int = 15
    """Steps of the regression by which candidates begin."""
    short_segment: int = 10
    """Rows of the segments that candidates are first fitted to."""
    longer_segment: int = 30
    """Rows of the segments that the best of them are fitted to."""
    least_noise: float = 1e-4
    """Independent errors below this share of a state's standard deviation cannot hide a term of a law: whatever is
    left then are systematic errors, of a solver for instance, for which rows do not count one by one."""
    stretches: tuple[int, ...] = (100, 30, 10)
    """Rows of the pieces that nearly clean trajectories may be simulated in."""
    systematic_numbers: float = 10.0
    """How many independent numbers systematic errors of a state are at least, and a solver's that are smaller than
    that: few, since they follow from its tolerance and the state. Each decade less is worth so many times 1.15 nats: a
    law whose terms are needed gains several decades, one that follows the solver's errors less than a third."""
    exact: float = 1e-8
    """Errors below this share of a state's standard deviation are those of the integration, not of the model."""
    first_lengths: Lengths = (8, 25, None)
    """Rows of the segments of a fit that nothing is known of yet; None: whole pieces."""
    batch: int = 64
    """Systems that are fitted between two looks at the work that has been done."""
    repeated: float = 1e-6
    """Misfits that differ by less, relative to their size, are of the same function in other words."""
    least_folds: int = 3
    """With fewer trajectories, too little is left to fit constants to."""
    most_folds: int = 10
    """More trajectories than this are left out several at a time."""
    validation_steps: int = 10
    """Steps of the fits of cross-validation, which begin where the fit to all trajectories ended."""
    compared_rows: int = 1_200
    """Structures are compared on at most about so many rows; constants are then fitted on all."""
    search_work: int = 45_000_000
    """Work of the local search: some seconds of one core."""
    reduction_work: int = 15_000_000
    """Work that may be spent beyond that on leaving out what an equation can do without."""
    exchange_work: int = 250_000_000
    """Work after which candidates are no longer exchanged; some times what systems need that are not stiff."""
    combined: int = 3
    """Candidates of each variable that are combined to begin with."""
    tolerances: tuple[float, float] = (1e-10, 1e-4)
    """Least and largest error of an integration step, over the standard deviation."""
    tolerated_noise: float = 0.01
    """Share of the noise that an integration step may err by, within `tolerances`."""
    exchange_rounds: Rounds = ((1, 16), (6, 5), (20, 2))
    """Rounds by which candidates of one variable are exchanged."""
    restart_rounds: Rounds = ((1, 16), (6, 16))
    """Rounds by which other beginnings of a local search are chosen."""
    exchanged_again: int = 30
    """Candidates of a variable that are tried again after another variable's equation has changed."""
    small_program: int = 9
    """Nodes of a small program: local searches from small and from large ones end elsewhere."""
    least_gain: float = 0.01
    """Nats by which a description must get shorter to count."""
    most_saved: float = 12.0
    """Nats that leaving out one constant may save, at most about."""
    overdraft: int = 60_000_000
    """Work that one comparison of many systems may take beyond the budget; only stiff ones need as much."""
    far: float = 10.0
    """Systems whose description is longer than the best by more nats are not reduced."""
    reduction_rounds: Rounds = ((2, 4), (10, 1))
    """Rounds by which reductions are compared."""
    pruning_steps: int = 8
    """Steps of the fit after one constant was made neutral."""
    extension_rounds: Rounds = ((1, 24), (4, 6), (12, 3))
    """Rounds by which extensions and neighbours are compared."""
    leap_rounds: Rounds = ((8, 2), (12, 2))
    """Rounds by which larger structural moves are compared."""
    shorter_pieces: tuple[int, ...] = (100, 30)
    """Rows of the pieces that are tried when longer ones cannot be fitted."""
    pieces_work: int = 450_000_000
    """Work after which no other lengths of pieces are tried."""
    noise_excess: float = 1.5
    """Residuals so many times as large as the noise are at its level."""
    slight: float = 1e-3
    """Residuals below this share of a state's standard deviation are small, whatever the noise."""
    long_trajectory: int = 200
    """Longer trajectories may be too chaotic for the neighbourhood of a bad fit to be worth looking at."""
    dear_work: int = 100_000_000
    """Work of a comparison from which the same is so of shorter trajectories: much would be left for nothing."""
    piece_steps: int = 20
    """Steps of the fit of a chosen system to pieces of another length."""
    piece_lengths: Lengths = (25, None)
    """Rows of the segments by which that fit goes."""
    most_rounded_constants: int = 16
    """Systems with more constants stay as fitted."""
    rounding_steps: int = 12
    """Steps of the fit of the other constants after some were made simple."""


@dataclass(frozen=True)
class InferenceSettings:
    """What is said of the model: errors of constants, residuals, verdicts."""

    error_digits: tuple[int, ...] = (2, 3, 5, 9, 17)
    """Digits of standard errors to which estimates are rounded: the first with which simulations stay as they are. With
    two they are off by at most a twentieth of a standard error."""
    unchanged_nats: float = 0.1
    """Nats by which the misfit may grow when estimates are rounded."""
    shown_steps: int = 20
    """Steps of the fit of the shown equations with all constants free."""
    high_correlation: float = 0.95
    """Correlations of at least this size between two constants are reported."""
    start_steps: int = 30
    """Steps of the fit of initial states with all constants fixed."""
    lags: int = 3
    """Rows this far apart are compared; a model that misses something errs the same way for several rows."""
    far_out: float = 3.0
    """Robust checks bring residuals in to so many standard deviations."""
    clean: float = 1e-5
    """Noise, or the uncertainty of a target, below this share of the standard deviation is none."""
    exact: float = 1e-6
    """Residuals below this share of the standard deviation are those of the integration."""
    negligible: float = 1e-3
    """Residuals below this share of the standard deviation may have any pattern."""
    improbable: float = 0.01
    """Probability below which residuals are not those of noise."""
    too_large: float = 1.25
    """Residuals this many times as large as the noise are too large, unless they may be so by chance."""
    patterned: float = 0.1
    """Share of the residuals' variance that may follow a pattern: constants that were made simple leave a little."""
    represented_lengths: int = 8
    """Lengths by which those of many trajectories are represented when the variance of residuals is judged."""
    bins_in_span: int = 40
    """Bins in a span of loess, at most, when the variance of residuals is judged: more tell nothing more."""
    most_bins: int = 240
    """Bins of a trajectory for which the variance of residuals is judged; of more a stretch is taken."""
    least_r2: float = 0.5
    """A simulation that explains less is no model."""
    good_r2: float = 0.9
    """A simulation that explains less of what is not noise is doubtful."""
    largest_uncertainty: float = 0.01
    """A target that is more uncertain cannot tell a law from nonsense of the same error; trajectories can."""
    least_target_r2: float = 0.1
    """An equation that explains less of its target is no better than a constant."""
    exact_constant: float = 1e-3
    """Largest standard error of a constant of an exact equation, over the constant. In the corpus's data without noise
    it is below 1e-4 in laws, and above 0.03 in terms that follow the errors of solvers."""
    distinct_nats: float = 3.0
    """What is not this much longer as a description may be right (odds of 20, as a good verdict may be wrong in one of
    twenty)."""
    beyond: float = 0.1
    """A simulation that leaves the measured range by more than this share of its width goes where nothing was seen."""
    foretold_starts: int = 12
    """Initial states from which the model and its rivals are simulated, and draws of the constants: what differs in one
    of ten is met with odds of 0.7."""
    foretold_rows: int = 80
    """Rows of such a simulation, over the duration of the longest trajectory."""
    foretold_shift: float = 3e-3
    """Change of an initial state, over the state's deviation, after which a course is still to be foretold: where it is
    not, chaos ends what can be."""
    loose: float = 0.5
    """A constant whose standard error is a larger share of it than this is not determined by the data."""


@dataclass(frozen=True)
class Settings:
    """The numbers of all stages: preparing data, then choosing the model."""

    common: CommonSettings = CommonSettings()
    checks: CheckSettings = CheckSettings()
    trajectories: TrajectorySettings = TrajectorySettings()
    smoothing: SmoothingSettings = SmoothingSettings()
    robustness: RobustnessSettings = RobustnessSettings()
    interpolation: InterpolationSettings = InterpolationSettings()
    quantisation: QuantisationSettings = QuantisationSettings()
    rows: RowSettings = RowSettings()
    structure: StructureSettings = StructureSettings()
    regression: RegressionSettings = RegressionSettings()
    sparse: SparseSettings = SparseSettings()
    shooting: ShootingSettings = ShootingSettings()
    selection: SelectionSettings = SelectionSettings()
    inference: InferenceSettings = InferenceSettings()


SETTINGS: Final = Settings()
"""The values in use."""
