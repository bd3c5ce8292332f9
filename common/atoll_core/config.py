"""The configuration of a job, grouped by purpose. Pure data: messages carry it, and it decides every bit of a result.

Two presets: ``default`` (all of Atoll's additions) and ``paper`` (Table II of Schmidt & Lipson 2008 without additions).
Fields that are ``None`` are set from the data when the job is prepared.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Final, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema

Preset = Literal["default", "paper"]
Loss = Literal["mae", "rmse"]
ConstantSteps = Literal["relative", "log-uniform"]
Agreement = Literal["difference", "relative"]

BASE_OPERATORS: Final = ("+", "-", "*", "/", "sin", "cos")
"""Operators with which a search begins."""
FURTHER_OPERATORS: Final = ("exp", "log", "sqrt", "abs", "tanh", "pow")
"""Operators that are also tried if the user names no operators and `BASE_OPERATORS` may not give the shortest
description."""

PAPER_TERMINALS = 7
TERMINALS_BEYOND_VARIABLES = 5

PositiveInt = Annotated[int, Field(ge=1, lt=2**63)]
_SEQUENCES: Final = frozenset({"list", "tuple", "set", "frozenset"})
Probability = Annotated[float, Field(ge=0.0, le=1.0)]


def _fail_fast(schema: object) -> None:
    if isinstance(schema, dict):
        if schema.get("type") in _SEQUENCES:
            schema["fail_fast"] = True
        for part in schema.values():
            _fail_fast(part)
    elif isinstance(schema, list):
        for part in schema:
            _fail_fast(part)


class Frozen(BaseModel):
    """Base of all validated models: frozen, unknown fields refused, NaN and infinity refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: type[BaseModel], handler: GetCoreSchemaHandler) -> CoreSchema:
        """Stop reading a sequence at its first wrong item: a million wrong items would make a million errors."""
        schema = handler(source)
        _fail_fast(schema)
        return schema


def _without(retired: Mapping[str, object]) -> Callable[[object], object]:
    """Return a validator that drops `retired` options of older files if their value describes the present behaviour."""

    def drop(data: object) -> object:
        if not isinstance(data, dict):
            return data
        return {name: value for name, value in data.items() if name not in retired or retired[name] != value}

    return drop


class Angle(Frozen):
    """One state or input that is an angle; its values are unwrapped before smoothing."""

    column: str
    degrees: bool = False


class DataConfig(Frozen):
    """How the columns of the table are to be read. Names are column names as in the header, without units."""

    time: str | None = Field(default=None, description="time column (default: `t` or `time`)")
    step: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = Field(
        default=None, description="time between rows of a table without a time column"
    )
    states: tuple[str, ...] | None = Field(
        default=None, description="state columns (default: all other numeric columns)"
    )
    inputs: tuple[str, ...] = Field(
        default=(), description="columns that are variables without an equation; may name time"
    )
    trajectory: str | None = Field(default=None, description="column whose value changes where a new trajectory begins")
    target: str | None = Field(
        default=None, description="explicit regression of this column on the others; no time needed"
    )
    derivatives: tuple[str, ...] | None = Field(
        default=None, description="given derivatives, one column per state, in order"
    )
    order: Literal[1, 2] = Field(default=1, description="2: positions are measured, the second derivative is sought")
    angles: tuple[Angle, ...] = ()
    only: tuple[str, ...] | None = Field(default=None, description="search these equations only")
    stochastic: bool = Field(default=False, description="identify the drift and the diffusion of a stochastic process")
    robust: bool = Field(default=False, description="smooth so that outliers lose their weight")
    holdout: PositiveInt | Annotated[str, Field(pattern=r"^.+=.+$")] | None = Field(
        default=None, description="trajectories kept from the search: the last N, or COLUMN=VALUE"
    )
    weights: str | None = Field(
        default=None, description="column of row weights: inverse variances, up to a factor; 0: unused"
    )
    offsets: tuple[str, ...] = Field(
        default=(), description="states measured with an unknown offset, different in each trajectory"
    )
    hold: tuple[str, ...] = Field(
        default=(), description="inputs that keep the value of a row until the next row (zero-order hold)"
    )
    group: str | None = Field(default=None, description="column; trajectories with equal values in it share constants")
    per_trajectory: bool = Field(default=False, description="each trajectory has separate constants")
    units: dict[str, str] = Field(default_factory=dict, description="units of columns, by name; they override headers")
    missing: Literal["refuse", "drop"] = Field(default="refuse", description="what to do with NaN and infinity")
    sheet: str | None = Field(
        default=None, description="sheet of an Excel workbook (default: the first sheet with a table)"
    )
    hidden: tuple[str, ...] = Field(
        default=(),
        description="states of the given equations that no column measures; without given equations, their number",
    )
    observe: dict[str, str] = Field(
        default_factory=dict, description="columns that are no states, each as an expression of states and parameters"
    )
    missing_values: tuple[float, ...] = Field(
        default=(), description="numbers that stand for missing values, which are dropped, such as -9999"
    )

    @property
    def hidden_count(self) -> int | None:
        """The number of hidden states, 0 to 9, if `hidden` is a digit; None if it names the states.

        The limit is set by hand: the courses of more states would be higher derivatives than noisy rows determine.
        """
        text = self.hidden[0] if len(self.hidden) == 1 else ""
        return int(text) if len(text) == 1 and text.isdecimal() else None


class SpaceConfig(Frozen):
    """The space of expressions."""

    operators: tuple[str, ...] | None = Field(
        default=None, description="None: + - * / sin cos, and further ones if they may improve the equation"
    )
    operators_of: dict[str, tuple[str, ...]] = Field(default_factory=dict, description="per equation; overrides")
    variables_of: dict[str, tuple[str, ...]] = Field(
        default_factory=dict, description="per equation, the variables that it may use (default: all)"
    )
    required_of: dict[str, tuple[str, ...]] = Field(
        default_factory=dict, description="per equation, the variables that it must have"
    )
    terminals: PositiveInt | None = Field(
        default=None, description="first nodes of a list; None: max(7, variables + 5)"
    )
    operator_nodes: Annotated[int, Field(ge=1, le=100)] = 25
    max_size: Annotated[int, Field(ge=1, le=120)] | None = Field(
        default=None, description="largest complexity on the front"
    )

    def operators_for(self, variable: str) -> tuple[str, ...]:
        """Return the operators that the search for the equation of `variable` uses."""
        return self.operators_of.get(variable, BASE_OPERATORS if self.operators is None else self.operators)

    def further_operators_for(self, variable: str) -> tuple[str, ...]:
        """Return further operators that may be tried for the equation of `variable`; none if the user named
        operators."""
        return () if self.operators is not None or variable in self.operators_of else FURTHER_OPERATORS

    def columns_for(self, variable: str, names: Sequence[str]) -> tuple[int, ...]:
        """Return the indices into `names` of the symbols that the equation of `variable` may use, ascending."""
        allowed = self.variables_of.get(variable, names)
        return tuple(index for index, name in enumerate(names) if name in allowed)

    def terminals_for(self, variables: int) -> int:
        """Return the number of terminals of a list over this many variables."""
        return self.terminals or max(PAPER_TERMINALS, variables + TERMINALS_BEYOND_VARIABLES)


class ParameterConfig(Frozen):
    """Bounds and start value of a parameter of given equations; None: no bound, or no start value."""

    lower: float | None = None
    upper: float | None = None
    start: float | None = None
    by: Literal["run"] | None = Field(default=None, description="run: each trajectory has a value of its own")

    @property
    def ends(self) -> tuple[float, float]:
        """The lower and the upper bound; infinite without a bound."""
        return -math.inf if self.lower is None else self.lower, math.inf if self.upper is None else self.upper


class PriorConfig(Frozen):
    """Prior knowledge as infix text over the table's symbols, by left-hand side such as `x` or `dx/dt`.

    When a job is prepared, left-hand sides become the names of their variables.
    """

    guesses: dict[str, tuple[str, ...]] = Field(
        default_factory=dict, description="expressions among which the islands begin; their constants are fitted"
    )
    known: dict[str, str] = Field(default_factory=dict, description="known equations, which are not searched")
    bounds: dict[str, tuple[str, ...]] = Field(
        default_factory=dict, description="bounds on constants, such as c > 0, by left-hand side; * for all equations"
    )
    equations: dict[str, str] = Field(
        default_factory=dict,
        description="given equations; their parameters are fitted, and ? stands for an unknown part, which is searched",
    )
    parameters: dict[str, ParameterConfig] = Field(
        default_factory=dict, description="bounds and start values of parameters of given equations, by name"
    )
    initial: dict[str, ParameterConfig] = Field(
        default_factory=dict, description="initial values of states: given (`start` without bounds), or their bounds"
    )
    positive: tuple[str, ...] = Field(default=(), description="equations whose right-hand side is nowhere negative")
    monotone: dict[str, tuple[str, ...]] = Field(
        default_factory=dict, description="monotone right-hand sides, such as `increasing in S`, by left-hand side"
    )
    limits: dict[str, tuple[str, ...]] = Field(
        default_factory=dict, description="limits of right-hand sides, such as `S -> 0: 0`, by left-hand side"
    )

    @property
    def by_run(self) -> tuple[str, ...]:
        """The parameters of which each trajectory has a value of its own. They are states with the rate 0."""
        return tuple(name for name, one in self.parameters.items() if one.by == "run")

    def shapes_of(self, equation: str) -> tuple[str, ...]:
        """Return the shapes that are demanded of an equation, or of its unknown part, as texts."""
        positive = ("positive",) if equation in self.positive else ()
        return (*positive, *self.monotone.get(equation, ()), *self.limits.get(equation, ()))

    @property
    def shaped(self) -> tuple[str, ...]:
        """The equations, or left-hand sides, of which a shape is demanded."""
        return tuple(dict.fromkeys((*self.positive, *self.monotone, *self.limits)))


class EvolutionConfig(Frozen):
    """Variation, selection and the fitting of constants."""

    islands: Annotated[int, Field(ge=1, le=1024)] = 8
    population: Annotated[int, Field(ge=4, le=4096, multiple_of=2)] = 64
    crossover: Probability = 0.75
    mutation: Probability = Field(default=0.05, description="per node")
    loss: Loss = "mae"
    constant_fit_steps: Annotated[int, Field(ge=0, le=100)] = Field(
        default=4, description="Levenberg-Marquardt steps per child"
    )
    constant_fit_gate: Annotated[float, Field(gt=0.0)] = Field(
        default=0.25, description="a child is fitted if its loss is at most this multiple of its worse parent's loss"
    )
    linear_terms: Annotated[int, Field(ge=0, le=4)] = Field(
        default=4, description="top-level terms fitted linearly; 0: none"
    )
    scaled_constants: bool = Field(
        default=True, description="draw constants over the data's scales, not from [-10, 10]"
    )
    constant_steps: ConstantSteps = Field(default="relative", description="how the mutation of a constant moves it")
    constant_moves: Probability = Field(
        default=0.5, description="share of mutated constants moved; the others are redrawn"
    )
    refit_interval: PositiveInt = Field(default=10, description="generations between offers to the front")
    runners_up: Annotated[int, Field(ge=0, le=64)] | None = Field(
        default=None,
        description="runners-up kept for each complexity; None: 0, or 8 with noisy targets",
    )


class PredictorConfig(Frozen):
    """Coevolved fitness predictors (paper, section 2.3 and Table II)."""

    enabled: bool = True
    rows: Annotated[int, Field(ge=4, le=1024)] | None = Field(
        default=None, description="None: 16, or 32 with noisy targets"
    )
    predictors: Annotated[int, Field(ge=2, le=64)] = 8
    trainers: Annotated[int, Field(ge=1, le=64)] = 8
    renewal: PositiveInt = Field(default=50, description="predictor generations between trainer renewals")
    effort: Probability = Field(default=0.05, description="largest share of all point evaluations")
    agreement: Agreement = Field(
        default="difference", description="how a predicted loss is compared with the exact one"
    )


class MigrationConfig(Frozen):
    """When solutions migrate between the islands of a variable."""

    generations: Annotated[int, Field(ge=1, le=10_000)] = 100
    joining: PositiveInt | None = Field(
        default=4, description="islands that begin the first epoch at a time; None: all"
    )


class BudgetConfig(Frozen):
    """When a job ends: by default by convergence, stagnation or a number of epochs, never by the clock."""

    target_error: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None, description="normalized error that is enough"
    )
    max_epochs: PositiveInt = 1000
    max_epochs_of: dict[str, PositiveInt] = Field(default_factory=dict, description="per variable; overrides")
    max_time: Annotated[float, Field(gt=0.0)] | None = Field(default=None, description="seconds")
    stagnation: PositiveInt | None = Field(
        default=None, description="epochs without a better equation after which a search ends; None: from data"
    )


class JobConfig(Frozen):
    """Everything that decides a result, apart from the table itself."""

    preset: Preset = "default"
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    data: DataConfig = DataConfig()
    space: Annotated[SpaceConfig, BeforeValidator(_without({"fixed_terminals": False, "arguments": "any node"}))] = (
        SpaceConfig()
    )
    prior: PriorConfig = PriorConfig()
    evolution: Annotated[
        EvolutionConfig,
        BeforeValidator(_without({"mutation_unit": "node", "crowding_distance": "live nodes", "ties_replace": True})),
    ] = EvolutionConfig()
    predictors: PredictorConfig = PredictorConfig()
    migration: MigrationConfig = MigrationConfig()
    budget: BudgetConfig = BudgetConfig()


PAPER = JobConfig(
    preset="paper",
    space=SpaceConfig(operators=BASE_OPERATORS, terminals=PAPER_TERMINALS),
    evolution=EvolutionConfig(
        constant_fit_steps=0, linear_terms=0, scaled_constants=False, constant_steps="log-uniform", runners_up=0
    ),
    predictors=PredictorConfig(rows=16, renewal=10, agreement="relative"),
    migration=MigrationConfig(joining=None),
    budget=BudgetConfig(max_epochs=5000, stagnation=500),
)
"""Table II of the paper without additions; ADR 0042 has its interpretation."""

PRESETS: dict[Preset, JobConfig] = {"default": JobConfig(), "paper": PAPER}
