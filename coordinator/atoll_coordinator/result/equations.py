"""One equation of a result: constants, verdict, groups, candidates, front, convergence of its search."""

from pydantic import Field

from atoll_coordinator.result.base import Count, Curve, Flag, Number, Numbers, Pair, Part, Text


class SimpleNumber(Part):
    """The most probable simple number near a constant, and its distance in standard errors."""

    value: Number = Field(default=None, description="the number")
    odds: Number = Field(default=None, description="odds of this number against all others")
    standard_errors: Number = Field(default=None, description="distance from the estimate")


class Estimate(Part):
    """A fitted number: `value` is displayed; `fitted` is the unrounded estimate, to which the errors refer."""

    value: Number = Field(default=None, description="the displayed number")
    std_error: Number = Field(default=None, description="standard error of `fitted`")
    fitted: Number = Field(default=None, description="the unrounded estimate")
    interval: Pair | None = Field(default=None, description="95 % interval of `fitted`")
    identifiable: Flag = Field(
        default=True, description="whether the data determine the number: the interval does not contain 0"
    )
    simple: SimpleNumber | None = Field(default=None, description="the most probable simple number near it")
    bounds: Pair | None = Field(default=None, description="range allowed by `--bound`, null on an open side")
    at_bound: Flag | None = Field(
        default=False, description="whether the number lies on a bound; its interval is then one-sided"
    )

    @property
    def estimate(self) -> float:
        """The unrounded estimate; the displayed number if there was no fit."""
        return next((number for number in (self.fitted, self.value) if number is not None), 0.0)

    @property
    def is_within(self) -> bool:
        """Whether the displayed number lies in the interval, if there is one."""
        low, high = self.interval or (None, None)
        value = self.value or 0.0
        return (low is None or low <= value) and (high is None or value <= high)


class Constant(Estimate):
    """A constant of an equation."""

    shared: Flag | None = Field(
        default=None,
        description="whether the constant has the same value in all groups of trajectories, null without groups",
    )
    unit: Text | None = Field(
        default=None, description="unit of the constant, `1` for a pure number, null if the units do not determine it"
    )


class RunValue(Constant):
    """The value of a parameter in one trajectory, if it differs by run."""

    run: Text = Field(description="name of the trajectory")
    held_out: Flag = Field(default=False, description="whether the trajectory was held out; its value was fitted to it")


class Factor(Part):
    """A factor that is not written; `of` is the term that it multiplies."""

    of: Text | None = Field(default=None, description="the term")


class ImpliedConstant(Estimate, Factor):  # fields of the last class come first in the file
    """A factor of 1 that is not written, with its fitted value."""


class ImpliedUnit(Factor):
    """A factor of 1 that is not written but has a unit."""

    unit: Text | None = Field(default=None, description="the unit of the factor")


class Units(Part):
    """Units of an equation, in addition to the units of its constants."""

    implied: tuple[ImpliedUnit, ...] = Field(default=(), description="factors of 1 that have a unit")
    faults: tuple[Text, ...] = Field(default=(), description="contradictions that no factor resolves")


class SimpleTogether(Part):
    """Simple numbers for several constants, judged together."""

    constants: tuple[Count, ...] = Field(
        default=(), description="positions in the list `constants` of the equation, from 0"
    )
    values: Curve = Field(default=(), description="the simple numbers")
    odds: Number = Field(default=None, description="odds of all these numbers against all other values")
    chi_square: Number = Field(default=None, description="increase of chi-square from the estimates to these numbers")


class Bound(Part):
    """A bound set by the user, and the numbers of the equation to which it applies."""

    bound: Text | None = Field(default=None, description="the bound as the user wrote it")
    values: Curve = Field(default=(), description="the numbers to which it applies")
    active: Flag | None = Field(default=None, description="whether one of these numbers lies on the bound")


class GroupEquation(Part):
    """An equation with the constants of one group of trajectories."""

    group: Text = Field(description="name of the group")
    expression: Text | None = Field(default=None, description="the equation")
    program: Text | None = Field(default=None, description="its operation list, hexadecimal")
    constants: tuple[Constant, ...] = Field(default=(), description="its constants")


class Prediction(Part):
    """How well states can be predicted from other initial states within the measured range."""

    starts: Count | None = Field(default=None, description="number of other initial states")
    followed: Count | None = Field(
        default=None, description="number of other initial states from which the simulation reached its end"
    )
    unfinished: Count | None = Field(
        default=None, description="number of other initial states whose simulation needed too many integration steps"
    )
    probability: Number = Field(
        default=None, description="total probability of the candidates and constants with about the same predictions"
    )
    novelty: Number = Field(
        default=None, description="median distance of predictions from measured rows, in units of the range"
    )
    reached: Number = Field(
        default=None, description="predicted value farthest outside of the measured range, else null"
    )
    is_disputed: Flag | None = Field(default=None, description="whether other candidates predict different values")
    measure_from: Numbers | None = Field(
        default=None, description="initial state from which a measurement is most informative"
    )


class Check(Part):
    """A check of an equation: its outcome, and the reason as a clause."""

    name: Text = Field(description="see Verdicts in result.md")
    outcome: Text = Field(description="`passed`, `failed`, `not made` or `not applicable`")
    reason: Text = Field(description="reason for the outcome, a clause")
    value: Number = Field(default=None, description="the value that was checked")
    limit: Number = Field(default=None, description="the limit for this value")
    power: Number = Field(
        default=None, description="smallest deviation that the check would have detected, as a share of the variance"
    )


class Convergence(Part):
    """The generations in which the error of an island decreased, and the errors."""

    island: Count = Field(default=0, description="number of the island")
    generations: tuple[Count, ...] = Field(
        default=(), min_length=1, description="generations in which the error decreased, at most 40"
    )
    errors: Curve = Field(default=(), min_length=1, description="the errors over the target's standard deviation")


class Candidate(Part):
    """An equation that was compared with the displayed equation."""

    expression: Text = Field(description="the equation")
    complexity: Count | None = Field(default=None, description="size of its program")
    nats: Number = Field(
        default=None, description="Δ description length; below about 3 the data hardly distinguish the two equations"
    )
    r2: Number = Field(default=None, description="R2 of the simulation")
    held_out_r2: Number = Field(default=None, description="R2 of held-out trajectories")
    cross_validated: Flag | None = Field(
        default=False, description="whether `held_out_r2` comes from leaving out one trajectory at a time"
    )
    origin: Text | None = Field(default=None, description="source of the candidate, as for the equation")
    selected: Flag = Field(default=False, description="whether it is the displayed equation")
    unknown: Text | None = Field(
        default=None, description="its unknown part, missing without a side from `--equation` that has one"
    )
    parameters: Numbers = Field(
        default_factory=dict, description="values of parameters that were fitted with it, missing if there are none"
    )


class Member(Part):
    """A member of the front, in its shortest written form."""

    expression: Text = Field(description="the equation in its shortest written form")
    complexity: Count | None = Field(default=None, description="size of its program")
    error: Number = Field(default=None, description="mean absolute error on all rows")
    normalized_error: Number = Field(default=None, description="`error` over the target's standard deviation")
    r2: Number = Field(default=None, description="R2 on the target")
    constants: tuple[Constant, ...] = Field(default=(), description="its constants")
    holdout_error: Number = Field(default=None, description="error on held-out rows")
    selected: Flag = Field(default=False, description="whether the displayed equation was derived from it")


class UnknownPart(Part):
    """An unknown part of a given equation, as it was found."""

    label: Text = Field(description="`?`, or `?1` if it has a number")
    expression: Text = Field(description="the expression that was found")
    program: Text | None = Field(default=None, description="its operation list, hexadecimal")


class GivenSide(Part):
    """A right-hand side from `--equation`: its parameters, and its unknown parts as they were found."""

    text: Text = Field(description="the right-hand side as the user wrote it")
    parameters: dict[Text, Count] = Field(
        default_factory=dict, description="position of each parameter in the list `constants`, from 0"
    )
    unknowns: tuple[UnknownPart, ...] = Field(default=(), description="the unknown parts")


class Observation(Part):
    """A measured column that is computed from states, from `--observe`."""

    column: Text = Field(description="name of the column")
    expression: Text = Field(description="the expression with its fitted constants")
    program: Text | None = Field(default=None, description="its operation list, hexadecimal")
    constants: tuple[Constant, ...] = Field(default=(), description="constants in the order of `program`")
    given: GivenSide = Field(description="the expression as the user wrote it")


class DemandedShape(Part):
    """A shape that was demanded of an equation, or of its unknown part."""

    shape: Text = Field(description="`positive`, `increasing in S` or `S -> 0: 0`")
    kept: Flag = Field(description="whether the equation has this shape at the measured rows and between them")


class Equation(Part):
    """One displayed equation, and how it was found; `expression` is null if no equation was found."""

    variable: Text = Field(description="name of the variable")
    lhs: Text = Field(description="left-hand side, such as dx/dt")
    expression: Text | None = Field(
        description="right-hand side; constants have 17 digits, sympy can parse it with the names in `symbols`"
    )
    program: Text | None = Field(default=None, description="the exact operation list that was computed, hexadecimal")
    origin: Text | None = Field(
        default=None, description="`front`, `runner-up`, `guess`, `library`, `descent` or `known`"
    )
    complexity: Count | None = Field(default=None, description="operators and terminals of the program")
    error: Number = Field(default=None, description="mean absolute error on all rows")
    normalized_error: Number = Field(default=None, description="`error` over the target's standard deviation")
    r2: Number = Field(default=None, description="R2 on the target")
    converged: Flag | None = Field(default=None, description="whether the error is at most `target_error`")
    constants: tuple[Constant, ...] = Field(default=(), description="constants in the order of `program`")
    given: GivenSide | None = Field(default=None, description="the side from `--equation`, missing without one")
    simple_together: SimpleTogether | None = Field(
        default=None, description="simple numbers for several constants, null if none are likely"
    )
    units: Units | None = Field(default=None, description="units, null if no column has a unit")
    groups: tuple[GroupEquation, ...] = Field(default=(), description="the equation of each group of trajectories")
    runs: tuple[RunValue, ...] = Field(
        default=(), description="the values of a parameter `by run`, a state with the rate 0; missing for others"
    )
    implied: tuple[ImpliedConstant, ...] = Field(default=(), description="factors of 1 that are not written")
    verdict: Text | None = Field(default=None, description="`exact`, `good`, `doubtful` or `no model`")
    reason: Text | None = Field(default=None, description="reason for the verdict, one sentence")
    checks: tuple[Check, ...] = Field(default=(), description="the checks that determine the verdict")
    epoch: Count | None = Field(default=None, description="number of complete epochs of the search")
    generation: Count | None = Field(default=None, description="generation in which it was found")
    point_evaluations: Count | None = Field(
        default=None, description="work of the search: one value at one row counts 1, with its gradient 3"
    )
    point_evaluations_by_part: dict[Text, Count] = Field(
        default_factory=dict, description="`point_evaluations` by part of the search"
    )
    seconds: Number = Field(default=None, description="duration of the search")
    why: Text | None = Field(
        default=None,
        description="end of search: `target`, `law`, `stagnation`, `max-epochs`, `max-time`, `cancelled` or `known`",
    )
    bounds: tuple[Bound, ...] = Field(default=(), description="bounds from `--bound`")
    shapes: tuple[DemandedShape, ...] = Field(
        default=(), description="shapes from `--positive`, `--monotone` and `--limit`, missing without one"
    )
    derivative_floor: Number = Field(
        default=None, description="uncertainty of the derivative, on the scale of `normalized_error`"
    )
    target_error: Number = Field(default=None, description="`--target-error`, or twice the floor (1e-9 at least)")
    prediction: Prediction | None = Field(default=None, description="predictions from other initial states")
    convergence: tuple[Convergence, ...] = Field(default=(), description="decrease of the error of each island")
    candidates: tuple[Candidate, ...] = Field(default=(), description="equations that were compared with this one")
    front: tuple[Member, ...] = Field(
        default=(),
        description="the best expression of each complexity; for a side from `--equation`, of its unknown part",
    )
    nats: Number = Field(default=None, description="Δ description length, if the equation was chosen by hand")
    is_of_all_groups: Flag = Field(
        default=False, description="whether it was chosen by hand; its constants are then the same in all groups"
    )
