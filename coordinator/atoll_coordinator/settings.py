"""All hand-set numbers that decide which equation is displayed and its verdict, by stage, with their reasons.

Other numbers are defined in the modules that use them: numbers of presentation, mathematical constants, guards against
division by zero, the sizes of compiled kernels and the numerics of minimisers and integrators.

How firmly a number is known varies. A docstring that quotes a measurement names the data and the result. A docstring
with only a reason states a judgement; the environment variable `VARIABLE` lets benchmarks change any of these numbers
and measure the effect.
"""

import ast
import logging
import math
import os
from dataclasses import dataclass, replace
from typing import Any, Final

Rounds = tuple[tuple[int, int], ...]
"""Rounds of a comparison: for each round, the steps of a fit and the number of systems that are kept."""


@dataclass(frozen=True)
class CommonSettings:
    """Numbers of more than one stage; shares are of a state's or a derivative's standard deviation."""

    negligible: float = 1e-3
    """A share that is too small to matter."""
    clean: float = 1e-5
    """Noise or uncertainty below this share counts as zero: bias and rounding of noise-free data are about as large."""
    fewest_rows: int = 5
    """Fewest rows of a differentiated trajectory, of a span, and of any search: four rows determine a cubic, one more
    tests it. An odd number, since it is the shortest span of a smoother."""
    few_values: int = 8
    """Fewest distinct values of a column: with fewer values, a pattern such as a common step is often due to chance."""
    significant: float = 3.0
    """Number of standard errors beyond which a finding, or a correlation, is significant (p = 0.003)."""
    improbable: float = 1e-6
    """Probability below which a pattern in many values, or between many rows, is not chance."""


@dataclass(frozen=True)
class SmoothingSettings:
    """How states are smoothed, or interpolated, and differentiated."""

    degrees: tuple[int, ...] = (3, 4)
    """Degrees of loess that are tried. A parabola may fit the values as well as a cubic, but its slope has far more
    bias: the measured derivative error was up to 2.8 times the standard error with parabolas, and up to 1.9 times
    without parabolas."""
    bins: int = 40
    """Fewest bins of a span if rows are thinned: means over a fortieth of a span lose no information."""
    rows_per_outlier: int = 150
    """Tails are heavy if at least one row in this many is an outlier. Tables without outliers and with noise of 0.2 to
    10 % had at most 2 in 400."""
    largest_noise: float = 3e-4
    """Noise, as a share of the state's standard deviation, beyond which data are never interpolated."""
    smallest_noise: float = 1e-9
    """Noise, as a share of the state's standard deviation, below which data count as noise-free."""
    judged_shares: tuple[float, ...] = (0.95, 0.75)
    """Interpolation and smoothing are compared on these shares of the rows, best rows first. So neither jumps nor rows
    at rest decide the comparison. Without noise, interpolation has the smaller error on at least one share; with noise,
    it has the larger error on both, by a factor near 1.5."""


@dataclass(frozen=True)
class ColumnSettings:
    """Findings about columns before the search."""

    least_rows: int = 30
    """Fewest rows for which correlations and neighbours are examined."""
    alike: float = 0.05
    """Largest residual of a relation up to noise, as a share of the column's standard deviation. With twice this limit,
    chance relations of slow motions were reported in 2 of 563 random tables (residuals of 6 and 8 %)."""
    clear: float = 0.3
    """Curvatures are compared if their noise is below this share of their median size. Measured: of 128 tables of full
    states, none was mistaken for a table of positions only (with half this value, one was). Of 128 tables of positions
    only, 71 were recognised."""


@dataclass(frozen=True)
class RowSettings:
    """Rows of the search."""

    most: int = 2_000
    """Approximate maximum of rows; larger tables are thinned. A derivative uses the measurements of many neighbours,
    and two thousand rows resolve every curve that a search can find."""
    over_median_uncertainty: float = 5.0
    """Rows whose uncertainty is less than this many times the median uncertainty are kept."""
    least_kept: float = 0.7
    """This share of the rows is kept regardless of uncertainty. Pieces between gaps must also contain this share."""
    most_uneven: float = 2.0
    """Largest ratio of the root mean square of the uncertainty to its mean, over the selected rows."""

    @property
    def in_sums(self) -> int:
        """Most rows in sums over a table; larger tables are subsampled."""
        return 10 * self.most

    @property
    def compared(self) -> int:
        """Most rows, values or windows that are compared with each other: the time grows with the square of their
        number."""
        return self.most // 5


@dataclass(frozen=True)
class EffortSettings:
    """Amounts of work, in the unit of `MultipleShooting.work`."""

    work: int = 180_000_000
    """Limit of the work of each part of a selection (libraries, exchange, local search): some seconds of one core.
    Beyond the limit, no new fit starts. Fits that have begun may need the same amount again."""
    steps: int = 40
    """Most steps of a fit; nearly all fits converge within ten."""
    beam: int = 12
    """Number of alternatives, decisions, neighbours or members that are kept. Also the most constants that may be
    replaced by simple numbers."""

    @property
    def brief_steps(self) -> int:
        """Steps of a short fit, which decides whether a candidate gets a full fit."""
        return self.steps // 6

    @property
    def kept(self) -> int:
        """Number of programs kept for the next stage if there are hundreds."""
        return 4 * self.beam

    @property
    def evaluations(self) -> int:
        """Point evaluations of the fits to one target after which no new program is tried."""
        return self.work // 15

    @property
    def fitted_sensitivities(self) -> int:
        """Largest product of the number of rows and the squared number of states in a fit of constants. The squared
        number of states is the number of sensitivities of a row to the initial states. With this limit, a fit takes
        `work` at most, if a row takes a step of three evaluations."""
        return self.work // (3 * self.steps)

    @property
    def longest_sum(self) -> int:
        """Largest number of terms in a sum that is fitted again without each term: the work grows with the square of
        this number."""
        return 2 * self.beam

    @property
    def rounds(self) -> Rounds:
        """Rounds by which many programs are narrowed down to a few: successive halving."""
        return (1, self.beam), (self.brief_steps, self.beam // 3), (self.steps, self.beam // 6)


@dataclass(frozen=True)
class CriterionSettings:
    """Prices of programs in nats: about minus the logarithm of the frequency of parts in equations of motion (compare
    the counts of Guimera et al. 2020 in a corpus of named equations)."""

    common: float = 1.4
    """A leaf, a sum, a product or a square, and each further use of a part: one of four choices."""
    nested: float = 5.0
    """A function inside a function, in addition to the prices of both."""

    @property
    def node(self) -> float:
        """Price of any node if there are no trajectories: ln 8, one of eight choices."""
        return math.log(8.0)

    @property
    def quotient(self) -> float:
        """A quotient: one of eight choices."""
        return 1.5 * self.common

    @property
    def function(self) -> float:
        """A sine, an exponential, a power with a constant exponent: one of thirty-two choices."""
        return 2.5 * self.common


@dataclass(frozen=True)
class SparseSettings:
    """Sparse regression: sums of products, and of products with functions."""

    degree: int = 4
    """Highest degree of products: few laws have a higher degree, and the size of a library grows fast with the
    degree."""
    largest_library: int = 130
    """Larger libraries are not tried: eliminating their terms costs the fourth power of their number."""
    rows_per_term: float = 2.0
    """Fewest independent rows for each term of a library: with fewer, a full library fits anything."""
    windows_in_width: int = 4
    """Number of windows of the weak form that begin within the width of one window. The longest trajectory must also
    contain at least this many half widths."""
    functions: int = 2
    """Most products with functions that are added to a sum."""
    most_constants: int = 7
    """Sums with more constants are not candidates for trajectories."""
    most_atoms: int = 40_000
    """Most products with functions, one for each inner constant tried, that are compared: some seconds of work."""
    trusted_share: float = 0.4
    """Share of the derivatives, most certain first, that are used in the search for functions. Measured for seven
    states with fast transients and 51 rows for each trajectory: with this share, the errors of the derivatives were
    1e-3 of the standard deviation; with a share of 0.7, they were 0.3 of it."""
    screened: int = 8
    """Most variables of an equation, if there are too many variables for a library of all products."""

    @property
    def rows(self) -> int:
        """Number of rows that determine the largest library. A pursuit also uses this number of rows."""
        return round(self.rows_per_term * self.largest_library)


@dataclass(frozen=True)
class ShootingSettings:
    """Fits of systems to trajectories by multiple shooting."""

    exact: float = 1e-8
    """Errors below this share of a state's standard deviation are integration errors, not errors of the model."""
    lengths: tuple[int, ...] = (10, 30, 100)
    """Lengths, in rows, of the first segments of a fit: fits of short segments converge from any guess. Trajectories
    are also simulated in pieces of these lengths, if errors of an initial state or of the solver grow too much along
    whole trajectories."""
    segment_growth: int = 5
    """Largest factor by which segments grow from one stage of a fit to the next, and from the longest segments to whole
    pieces."""

    @property
    def piece(self) -> int:
        """Most rows of a trajectory that are simulated without a break: the misfit of longer pieces has many minima."""
        return self.segment_growth * self.lengths[-1]


@dataclass(frozen=True)
class SelectionSettings:
    """Selection of the equations that together are the model.

    The estimator counts the work, see `MultipleShooting.work`.
    """

    least_noise: float = 1e-4
    """Independent errors below this share of a state's standard deviation cannot hide a term of a law. Residuals below
    this share are systematic errors, for instance of a solver, and are not independent between rows. A process with
    less noise than this share of its median step counts as deterministic."""
    usual_length: float = 30.0
    """Description length in nats of an equation's structure and constants, above which an equation is suspect: of the
    174 laws that `benchmarks.corpus --in-turn --seeds 1600-1628` draws, four in five are shorter (median 22, 2.5 nats
    for each constant). If an equation is longer, a short law may exist that was not proposed, even if the residuals are
    small."""
    systematic_numbers: float = 10.0
    """Least number of independent numbers in the systematic errors of a state. Errors of a solver count as this many
    numbers: few, since these errors follow from the tolerance and the state. For each number, residuals smaller by a
    factor of ten gain 1.15 nats. Necessary terms of a law gain several decades; a term that fits a solver's errors
    gains less than a third of a decade."""
    compared_rows: int = 1_200
    """Approximate maximum of rows on which structures are compared; constants are then fitted on all rows."""
    fewest_steps: int = 100
    """Fewest steps from row to row for the search of a stochastic process; 100 steps determine a variance within 14
    %."""
    least_gain: float = 0.1
    """Smallest difference of description lengths that counts, in nats."""

    @property
    def compared_numbers(self) -> int:
        """With many states, structures are compared on at most about this many numbers (rows times states). The work
        for a row grows at least with the square of the number of states, and each row has information on every
        equation."""
        return 6 * self.compared_rows


@dataclass(frozen=True)
class InferenceSettings:
    """Inference on the model: errors of constants, residuals, verdicts."""

    exact: float = 1e-6
    """Residuals below this share of the standard deviation are integration errors."""
    excess: float = 1.25
    """Residuals larger than this many times the noise are too large, unless the difference may be chance."""
    part: float = 0.1
    """Share of a variance, or of a measured range, that is relevant: a pattern in residuals, unexplained variance, or a
    simulation outside of the range. An equation that explains less is not a model."""
    improbable: float = 0.01
    """Probability below which residuals do not count as noise. Also the accepted share of good equations that are due
    to chance. The accepted share of wrong exact verdicts is half of this share."""
    largest_uncertainty: float = 0.01
    """Largest uncertainty of a target, as a share of its standard deviation: a more uncertain target does not
    distinguish a law from wrong equations of the same error."""
    distinct_nats: float = 3.0
    """Alternatives within this Δ description length may be right (odds of 20: one in twenty good verdicts may be
    wrong)."""
    denominators: tuple[int, ...] = (1, 2, 3, 4, 6)
    """Denominators of simple fractions."""

    @property
    def chance_nats(self) -> float:
        """Δ log-likelihood, relative to no equation, above which an equation is not chance (odds of 100)."""
        return round(-math.log(self.improbable), 1)

    @property
    def exact_nats(self) -> float:
        """Alternatives within this Δ description length may be the law instead of an exact equation (odds of 200)."""
        return round(-math.log(0.5 * self.improbable), 1)


@dataclass(frozen=True)
class Settings:
    """The numbers of all stages: preparing data, then choosing the model."""

    common: CommonSettings = CommonSettings()
    smoothing: SmoothingSettings = SmoothingSettings()
    columns: ColumnSettings = ColumnSettings()
    rows: RowSettings = RowSettings()
    effort: EffortSettings = EffortSettings()
    criterion: CriterionSettings = CriterionSettings()
    sparse: SparseSettings = SparseSettings()
    shooting: ShootingSettings = ShootingSettings()
    selection: SelectionSettings = SelectionSettings()
    inference: InferenceSettings = InferenceSettings()


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
    logging.getLogger(__name__).warning("%s is set (%s): results may differ from the defaults", VARIABLE, _CHANGES)

SETTINGS: Final = with_changes(Settings(), _CHANGES)
"""The values in use."""
