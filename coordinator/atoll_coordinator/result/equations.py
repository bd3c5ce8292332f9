"""One equation of a result: constants, verdict, groups, candidates, front, course of its search."""

from pydantic import Field

from atoll_coordinator.result.base import Count, Curve, Flag, Number, Numbers, Pair, Part, Text


class SimpleNumber(Part):
    """The most probable simple number near a constant, and how many standard errors that is off."""

    value: Number = None
    odds: Number = None
    standard_errors: Number = None


class Estimate(Part):
    """A number that was fitted: `value` is shown, `fitted` the estimate in full, to which errors belong."""

    value: Number = None
    std_error: Number = None
    fitted: Number = None
    interval: Pair | None = None
    identifiable: Flag = True
    simple: SimpleNumber | None = None
    bounds: Pair | None = None
    at_bound: Flag | None = False

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

    shared: Flag | None = None
    unit: Text | None = None


class Factor(Part):
    """A factor that nobody writes, and the term `of` which it is one."""

    of: Text | None = None


class ImpliedConstant(Estimate, Factor):  # fields of the last class stand first in the file
    """A factor of 1 that nobody writes, as it was fitted."""


class ImpliedUnit(Factor):
    """A factor of 1 that nobody writes, but which has a unit."""

    unit: Text | None = None


class Units(Part):
    """What units say of an equation beside those of its constants; `faults` are what no factor makes right."""

    implied: tuple[ImpliedUnit, ...] = ()
    faults: tuple[Text, ...] = ()


class SimpleTogether(Part):
    """Simple numbers of the `constants` at these places, judged together."""

    constants: tuple[Count, ...] = ()
    values: Curve = ()
    odds: Number = None
    chi_square: Number = None


class Bound(Part):
    """A bound that the user has set, and the numbers of the equation that it is about."""

    bound: Text | None = None
    values: Curve = ()
    active: Flag | None = None


class GroupEquation(Part):
    """An equation with the constants of one group of trajectories."""

    group: Text
    expression: Text | None = None
    program: Text | None = None
    constants: tuple[Constant, ...] = ()


class Prediction(Part):
    """How far states can be foretold from other initial states within the measured range."""

    starts: Count | None = None
    followed: Count | None = None
    unfinished: Count | None = None
    probability: Number = None
    novelty: Number = None
    reached: Number = None
    is_disputed: Flag | None = None
    measure_from: Numbers | None = None


class Check(Part):
    """A check of an equation: "passed", "failed", "not made" or "not applicable", and the reason as a clause.

    `power` is the smallest departure that it would have seen, as a share of the variance of the state or target.
    """

    name: Text
    outcome: Text
    reason: Text
    value: Number = None
    limit: Number = None
    power: Number = None


class Convergence(Part):
    """The generations in which the error of an island fell, and these errors over the target's deviation."""

    island: Count = 0
    generations: tuple[Count, ...] = Field(default=(), min_length=1)
    errors: Curve = Field(default=(), min_length=1)


class Candidate(Part):
    """An equation that was compared with the one shown."""

    expression: Text
    complexity: Count | None = None
    nats: Number = None
    r2: Number = None
    held_out_r2: Number = None
    cross_validated: Flag | None = False
    origin: Text | None = None
    selected: Flag = False


class Member(Part):
    """A member of the front, in its shortest writing."""

    expression: Text
    complexity: Count | None = None
    error: Number = None
    normalized_error: Number = None
    r2: Number = None
    constants: tuple[Constant, ...] = ()
    holdout_error: Number = None
    selected: Flag = False


class Equation(Part):
    """One equation as it is shown, and how it was found; `expression` is None where nothing was.

    `is_of_all_groups`: its constants are of all groups of trajectories together, since it was chosen by hand.
    """

    variable: Text
    lhs: Text
    expression: Text | None
    program: Text | None = None
    origin: Text | None = None
    complexity: Count | None = None
    error: Number = None
    normalized_error: Number = None
    r2: Number = None
    converged: Flag | None = None
    constants: tuple[Constant, ...] = ()
    simple_together: SimpleTogether | None = None
    units: Units | None = None
    groups: tuple[GroupEquation, ...] = ()
    implied: tuple[ImpliedConstant, ...] = ()
    verdict: Text | None = None
    reason: Text | None = None
    checks: tuple[Check, ...] = ()
    epoch: Count | None = None
    generation: Count | None = None
    point_evaluations: Count | None = None
    point_evaluations_by_part: dict[Text, Count] = Field(default_factory=dict)
    seconds: Number = None
    why: Text | None = None
    bounds: tuple[Bound, ...] = ()
    derivative_floor: Number = None
    target_error: Number = None
    prediction: Prediction | None = None
    convergence: tuple[Convergence, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    front: tuple[Member, ...] = ()
    nats: Number = None
    is_of_all_groups: Flag = False
