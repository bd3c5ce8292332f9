"""What an export writes down of a model, in no language yet. Letters: D states, N times."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from atoll.model.parameters import Parameter
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program


@dataclass(frozen=True, eq=False)
class Formula:
    """An expression: its program over the symbols of the description, and the names of constants that have one."""

    program: Program
    constants: Mapping[int, str]


@dataclass(frozen=True, eq=False)
class State:
    """A state: its `name` in expressions, its `column` in the data ("" where it has none), its `unit`.

    `rate` is its derivative, `start` its initial value. Errors are to be small beside `size`, above 0; of a process 0.
    """

    name: str
    column: str
    unit: str
    rate: Formula
    start: float
    size: float


@dataclass(frozen=True, eq=False)
class Input:
    """A variable without an equation.

    It is the time itself, is held at a `value`, or goes along a `table`: pieces of cubics, (N - 1, 5), each the time
    from which it holds and the coefficients of the powers 0 to 3 of the time since then; `until` is the last time.
    Its `status` is that nothing is known of it, or that what was recorded was dropped, where it is held at 0 for that.
    """

    name: str
    column: str
    unit: str
    kind: Literal["time", "value", "table"]
    value: float = 0.0
    table: FloatArray | None = None
    until: float = 0.0
    status: Literal["known", "unknown", "dropped"] = "known"


@dataclass(frozen=True, eq=False)
class Description:
    """A model as it is exported.

    `symbols` are the variables of all formulas. The `states` go from `begin` to `end` in `steps` equal steps; for order
    2 velocities are behind the positions. `covariance` has the entries of g g' of a process dx = f dt + g dW by the
    places of two states. A regression has no state, and a `value`. `constants` are those with a name, `origin` has
    lines that say where the model comes from, `zeros` sentences on the inputs that are held at 0 for want of a value.
    """

    symbols: tuple[str, ...]
    states: tuple[State, ...]
    inputs: tuple[Input, ...]
    constants: tuple[Parameter, ...]
    value: Formula | None
    covariance: Mapping[tuple[int, int], Formula]
    begin: float
    end: float
    steps: int
    time: str
    time_unit: str
    target: str
    origin: tuple[str, ...]
    zeros: tuple[str, ...]

    @property
    def variables(self) -> "tuple[State | Input, ...]":
        """States and inputs, the time left out."""
        return (*self.states, *(variable for variable in self.inputs if variable.kind != "time"))

    @property
    def tables(self) -> tuple[Input, ...]:
        """The inputs that go along a table."""
        return tuple(variable for variable in self.inputs if variable.kind == "table")

    @property
    def held(self) -> tuple[Input, ...]:
        """The inputs that are held at a value."""
        return tuple(variable for variable in self.inputs if variable.kind == "value")

    @property
    def depends_on_time(self) -> bool:
        """Whether the time itself is an input."""
        return any(variable.kind == "time" for variable in self.inputs)
