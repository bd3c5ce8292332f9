"""One equation of a result: constants, verdict, groups, candidates, front, course of its search."""

from pydantic import Field

from atoll_coordinator.result.base import Count, Curve, Flag, Number, Numbers, Pair, Part, Text


class SimpleNumber(Part):
    """The most probable simple number near a constant, and how many standard errors that is off."""

    value: Number = Field(default=None, description="the number")
    odds: Number = Field(default=None, description="odds of this number against all others")
    standard_errors: Number = Field(default=None, description="distance from the estimate")


class Estimate(Part):
    """A number that was fitted: `value` is shown, `fitted` the estimate in full, to which errors belong."""

    value: Number = Field(default=None, description="as it is shown")
    std_error: Number = Field(default=None, description="standard error of `fitted`")
    fitted: Number = Field(default=None, description="the estimate in full")
    interval: Pair | None = Field(default=None, description="95 % interval of `fitted`")
    identifiable: Flag = Field(default=True, description="whether the data determine it: the interval does not hold 0")
    simple: SimpleNumber | None = Field(default=None, description="the most probable simple number near it")
    bounds: Pair | None = Field(default=None, description="what `--bound` allows, null on an open side")
    at_bound: Flag | None = Field(
        default=False, description="whether it lies on a bound; its interval is one-sided then"
    )

    @property
    def estimate(self) -> float:
        """The estimate in full, what is shown where there was no fit."""
        return next((number for number in (self.fitted, self.value) if number is not None), 0.0)

    @property
    def is_within(self) -> bool:
        """Whether the number that is shown lies in the interval, if there is one."""
        low, high = self.interval or (None, None)
        value = self.value or 0.0
        return (low is None or low <= value) and (high is None or value <= high)


class Constant(Estimate):
    """A constant of an equation; `shared`: all groups of trajectories have it in common, None without groups."""

    shared: Flag | None = Field(
        default=None, description="whether all groups of trajectories have it in common, null without groups"
    )
    unit: Text | None = Field(default=None, description="its unit, `1` of a pure number, null where units do not tell")


class Factor(Part):
    """A factor that is not written, and the term `of` which it is one."""

    of: Text | None = Field(default=None, description="the term")


class ImpliedConstant(Estimate, Factor):  # fields of the last class stand first in the file
    """A factor of 1 that is not written, as it was fitted."""


class ImpliedUnit(Factor):
    """A factor of 1 that is not written but has a unit."""

    unit: Text | None = Field(default=None, description="the unit of the factor")


class Units(Part):
    """What units say of an equation beside those of its constants; `faults` are what no factor makes right."""

    implied: tuple[ImpliedUnit, ...] = Field(default=(), description="factors of 1 that have a unit")
    faults: tuple[Text, ...] = Field(default=(), description="contradictions that no factor resolves")


class SimpleTogether(Part):
    """Simple numbers of the `constants` at these places, judged together."""

    constants: tuple[Count, ...] = Field(default=(), description="places among `constants`, from 0")
    values: Curve = Field(default=(), description="the simple numbers")
    odds: Number = Field(default=None, description="odds of all of them against everything else")
    chi_square: Number = Field(default=None, description="increase of chi square from the estimates to these numbers")


class Bound(Part):
    """A bound that the user has set, and the numbers of the equation that it is about."""

    bound: Text | None = Field(default=None, description="the bound as it was given")
    values: Curve = Field(default=(), description="the numbers that it is about")
    active: Flag | None = Field(default=None, description="whether one of them lies on its end")


class GroupEquation(Part):
    """An equation with the constants of one group of trajectories."""

    group: Text = Field(description="name of the group")
    expression: Text | None = Field(default=None, description="the equation")
    program: Text | None = Field(default=None, description="its operation list, hexadecimal")
    constants: tuple[Constant, ...] = Field(default=(), description="its constants")


class Prediction(Part):
    """How well states can be predicted from other initial states within the measured range."""

    starts: Count | None = Field(default=None, description="number of other initial states")
    followed: Count | None = Field(default=None, description="from how many the simulation reached its end")
    unfinished: Count | None = Field(default=None, description="from how many it needed too many integration steps")
    probability: Number = Field(
        default=None, description="share of the odds of candidates and constants that predict the same"
    )
    novelty: Number = Field(default=None, description="median distance from measured rows, over the range")
    reached: Number = Field(default=None, description="value farthest outside of the measured range, null if within")
    is_disputed: Flag | None = Field(default=None, description="whether candidates predict something different")
    measure_from: Numbers | None = Field(default=None, description="initial state from which a measurement tells most")


class Check(Part):
    """A check of an equation: "passed", "failed", "not made" or "not applicable", and the reason as a clause.

    `power` is the smallest departure that it would have seen, as a share of the variance of the state or target.
    """

    name: Text = Field(description="see Verdicts in result.md")
    outcome: Text = Field(description="`passed`, `failed`, `not made` or `not applicable`")
    reason: Text = Field(description="a clause")
    value: Number = Field(default=None, description="what was measured")
    limit: Number = Field(default=None, description="what it is compared with")
    power: Number = Field(
        default=None, description="smallest departure that it would have seen, as a share of the variance"
    )


class Convergence(Part):
    """The generations in which the error of an island fell, and these errors over the target's deviation."""

    island: Count = Field(default=0, description="number of the island")
    generations: tuple[Count, ...] = Field(default=(), min_length=1, description="when its error fell, at most 40")
    errors: Curve = Field(default=(), min_length=1, description="the errors over the target's standard deviation")


class Candidate(Part):
    """An equation that was compared with the one shown."""

    expression: Text = Field(description="the equation")
    complexity: Count | None = Field(default=None, description="size of its program")
    nats: Number = Field(default=None, description="Δ description length; below about 3 the data hardly decide")
    r2: Number = Field(default=None, description="R2 of the simulation")
    held_out_r2: Number = Field(default=None, description="R2 of trajectories that took no part")
    cross_validated: Flag | None = Field(
        default=False, description="whether these are trajectories left out one at a time"
    )
    origin: Text | None = Field(default=None, description="as of the equation")
    selected: Flag = Field(default=False, description="whether it is the one shown")


class Member(Part):
    """A member of the front, in its shortest writing."""

    expression: Text = Field(description="the equation in its shortest writing")
    complexity: Count | None = Field(default=None, description="size of its program")
    error: Number = Field(default=None, description="mean absolute error on all rows")
    normalized_error: Number = Field(default=None, description="`error` over the target's standard deviation")
    r2: Number = Field(default=None, description="R2 on the target")
    constants: tuple[Constant, ...] = Field(default=(), description="its constants")
    holdout_error: Number = Field(default=None, description="error on held-out rows")
    selected: Flag = Field(default=False, description="whether the equation was made of it")


class Equation(Part):
    """One equation as it is shown, and how it was found; `expression` is None where nothing was.

    `is_of_all_groups`: its constants are of all groups of trajectories together, since it was chosen by hand.
    """

    variable: Text = Field(description="name of the variable")
    lhs: Text = Field(description="left-hand side, such as dx/dt")
    expression: Text | None = Field(
        description="right-hand side; constants have 17 digits, sympy reads it with `symbols`"
    )
    program: Text | None = Field(default=None, description="its operation list, hexadecimal: exactly what was computed")
    origin: Text | None = Field(
        default=None, description="`front`, `runner-up`, `guess`, `library`, `descent` or `known`"
    )
    complexity: Count | None = Field(default=None, description="operators and terminals of the program")
    error: Number = Field(default=None, description="mean absolute error on all rows")
    normalized_error: Number = Field(default=None, description="`error` over the target's standard deviation")
    r2: Number = Field(default=None, description="R2 on the target")
    converged: Flag | None = Field(default=None, description="whether the error is at most `target_error`")
    constants: tuple[Constant, ...] = Field(default=(), description="its constants, in the order of `program`")
    simple_together: SimpleTogether | None = Field(
        default=None, description="simple numbers of several constants, null where none are likely"
    )
    units: Units | None = Field(default=None, description="null where no column has a unit")
    groups: tuple[GroupEquation, ...] = Field(default=(), description="the equation of each group of trajectories")
    implied: tuple[ImpliedConstant, ...] = Field(default=(), description="factors of 1 that are not written")
    verdict: Text | None = Field(default=None, description="`exact`, `good`, `doubtful` or `no model`")
    reason: Text | None = Field(default=None, description="why, in a sentence")
    checks: tuple[Check, ...] = Field(default=(), description="what the verdict follows from")
    epoch: Count | None = Field(default=None, description="complete epochs of the search")
    generation: Count | None = Field(default=None, description="generation in which it was found")
    point_evaluations: Count | None = Field(
        default=None, description="work: one value at one row is 1, with its gradient 3"
    )
    point_evaluations_by_part: dict[Text, Count] = Field(
        default_factory=dict, description="the same by part of the search"
    )
    seconds: Number = Field(default=None, description="duration of the search")
    why: Text | None = Field(
        default=None, description="`target`, `law`, `stagnation`, `max-epochs`, `max-time`, `cancelled` or `known`"
    )
    bounds: tuple[Bound, ...] = Field(default=(), description="what `--bound` says of it")
    derivative_floor: Number = Field(
        default=None, description="uncertainty of the derivative, on the scale of `normalized_error`"
    )
    target_error: Number = Field(default=None, description="`--target-error`, or twice the floor (1e-9 at least)")
    prediction: Prediction | None = Field(default=None, description="predictions from other initial states")
    convergence: tuple[Convergence, ...] = Field(default=(), description="how the error of each island fell")
    candidates: tuple[Candidate, ...] = Field(default=(), description="equations that were compared with it")
    front: tuple[Member, ...] = Field(default=(), description="the best expression of each complexity")
    nats: Number = Field(default=None, description="Δ description length of one chosen by hand")
    is_of_all_groups: Flag = Field(default=False, description="whether it was chosen by hand for all groups")
