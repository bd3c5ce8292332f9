"""The constants of a model by name, with their errors.

Letters: P constants of a vector field, K constants whose joint covariance is known.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from atoll.model.vector_field import VectorField
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places, with_constants
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.unit_coefficients import ExplicitCoefficients, as_written, make_coefficients_explicit

LEVEL: Final = 0.95
"""The level of the intervals that a result has."""

_FIRST_MARK: Final = 1000.5
"""Constants are told apart by numbers from here on while an equation is written as text and read again."""


@dataclass(frozen=True)
class Parameter:
    """A constant of a model.

    `name` is c1, c2, … over all equations, `variable` the state of its equation; `stderr` is its standard error,
    `interval` its 95 % one, None where they are not known; `identifiable`: the data determine it. `unit` is its unit,
    "1" of a pure number, None where units do not tell; `bounds` are those that were set for it, None on an open side.
    """

    name: str
    variable: str
    value: float
    stderr: float | None = None
    interval: tuple[float, float] | None = None
    identifiable: bool = True
    unit: str | None = None
    bounds: tuple[float | None, float | None] | None = None

    def interval_at(self, level: float, freedom: float | None) -> tuple[float, float] | None:
        """Return the interval at `level`, by Student's t with so many degrees of freedom (None: infinitely many).

        None where there is none, or where it is known at 95 % alone, as that of a constant on its bound is.
        """
        if level == LEVEL:
            return self.interval
        if self.stderr is None or self.interval is None:
            return None
        from scipy import special

        quantile = special.ndtri(0.5 + level / 2.0) if freedom is None else special.stdtrit(freedom, 0.5 + level / 2.0)
        middle = 0.5 * (self.interval[0] + self.interval[1])
        return middle - float(quantile) * self.stderr, middle + float(quantile) * self.stderr


def parameters_of(result: Mapping[str, Any], equations: Sequence[Mapping[str, Any]]) -> dict[str, Parameter]:
    """Return the constants of these equations of a result by name, in the order of a `VectorField` of them.

    Where groups of trajectories differ in a constant, it has a value for each: ``c1[strain 2]``.
    """
    names, label = list(result["symbols"].values()), _label(result)
    found: list[Parameter] = []
    count = 0
    for equation in equations:
        own = [(f"[{label} {each['group']}]", _read(each, names)) for each in equation.get("groups") or ()]
        for place, (value, its) in enumerate(_read(equation, names)):
            count += 1
            values = [("", value, its)]
            if own and (its is None or its.get("shared") is False):
                values = [(group, *read[place]) for group, read in own]
            for group, number, known in values:
                name, variable = f"c{count}{group}", equation["variable"]
                unknown = Parameter(
                    name, variable, number
                )  # a number that only the text has, as the 2 of 2*x for x + x
                found.append(unknown if known is None else _parameter(name, variable, number, known))
    return {each.name: each for each in found}


def constant_names(result: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return by equation what its `constants` are called in `parameters_of`; one that its text lacks by its value."""
    names, count, found = list(result["symbols"].values()), 0, {}
    for equation in result["equations"]:
        read = [] if equation["expression"] is None else _read(equation, names)
        known = {id(its): f"c{count + place}" for place, (_, its) in enumerate(read, start=1)}
        constants = equation.get("constants") or ()
        found[equation["variable"]] = [known.get(id(its)) or f"{its['value'] or 0.0:.6g}" for its in constants]
        count += len(read)
    return found


def _label(result: Mapping[str, Any]) -> str:
    """Return what groups of trajectories are told apart by."""
    return str(((result.get("config") or {}).get("data") or {}).get("group") or "trajectory")


def _read(equation: Mapping[str, Any], names: Sequence[str]) -> list[tuple[float, Mapping[str, Any] | None]]:
    """Return the numbers of an equation's text, each with what is known of it if it is one of its constants."""
    known = list(equation.get("constants") or ())
    program = from_infix(equation["expression"], names)
    found: list[tuple[float, Mapping[str, Any] | None]] = []
    for value in program.constants[constant_places(program)].tolist():
        its = next((each for each in known if each["value"] is not None and abs(each["value"]) == abs(value)), None)
        if its is not None:
            known.remove(its)
        found.append((value, its))
    return found


def differing_groups(result: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the groups of trajectories of a result; none where no constant differs between them."""
    if not any(_differs(equation) for equation in result["equations"]):
        return ()
    return tuple(str(each["group"]) for each in result.get("groups") or ())


def remark_on_groups(result: Mapping[str, Any]) -> str:
    """Return a line that says of which group the constants in equations are, or of which groups they are means.

    Members of fronts and candidates have constants of all groups together. "" where there are no groups.
    """
    together = ", ".join(each["lhs"] for each in result["equations"] if each.get("is_of_all_groups"))
    if result.get("group") is not None:
        others = f"; those of {together} are of all groups together" if together else ""
        return f"Constants are those of group {' '.join(str(result['group']).split())}{others}."
    if together:
        return f"Constants of {together} are of all groups together, which may differ in them."
    names = " ".join(", ".join(differing_groups(result)).split())
    return f"Constants that differ between groups are means over them; the groups are {names}." if names else ""


def _differs(equation: Mapping[str, Any]) -> bool:
    """Tell whether an equation has a constant that is not the same in all groups."""
    known = equation.get("constants") or ()
    if known and all(each.get("shared") for each in known):
        return False  # the mean of equal numbers may have another last bit
    return any(each["expression"] != equation["expression"] for each in equation.get("groups") or ())


def of_group(result: Mapping[str, Any], group: Mapping[str, Any]) -> dict[str, Any]:
    """Return a result with the constants and the trajectories of one `group` of its groups alone, named as `group`."""
    name = group["group"]
    equations = []
    for equation in result["equations"]:
        its: Mapping[str, Any] = next((each for each in equation.get("groups") or () if each["group"] == name), {})
        taken = {key: its[key] for key in ("expression", "program", "constants") if key in its}
        equations.append({**equation, **taken, "groups": []})
    made = {**result, "equations": equations, "covariance": group.get("covariance"), "groups": [], "group": name}
    for part in ("simulation", "data"):
        whole = result.get(part)
        if whole and whole.get("trajectories"):
            chosen = [each for each in whole["trajectories"] if each["name"] in group["trajectories"]]
            made[part] = {**whole, "trajectories": chosen}
    return made | {"noise": _noise_of(result, made)}


def _noise_of(result: Mapping[str, Any], made: Mapping[str, Any]) -> dict[str, Any]:
    """Return the noise with as many independent rows as the trajectories of one group have, of those of all."""
    whole, part = (_searched_rows(each) for each in (result, made))
    noise = dict(result.get("noise") or {})
    for name, its in noise.items():
        errors = (its or {}).get("errors")
        if errors and errors.get("independent_rows") and whole:
            independent = errors["independent_rows"] * part / whole
            noise[name] = {**its, "errors": {**errors, "independent_rows": independent}}
    return noise


def _searched_rows(result: Mapping[str, Any]) -> int:
    listed = (result.get("data") or {}).get("trajectories") or ()
    return sum(each.get("rows") or 0 for each in listed if not each.get("held_out"))


def _parameter(name: str, variable: str, value: float, its: Mapping[str, Any]) -> Parameter:
    """Return a constant with its errors; the sign of `value` is that of the text, where a minus may stand before it."""
    is_turned = value * its["value"] < 0.0
    interval, bounds = (_turned(its.get(key), is_turned) for key in ("interval", "bounds"))
    low, high = interval or (None, None)
    both = None if low is None or high is None else (low, high)
    is_identifiable = bool(its.get("identifiable", True))
    return Parameter(name, variable, value, its.get("std_error"), both, is_identifiable, its.get("unit"), bounds)


def _turned(its: Sequence[float | None] | None, is_turned: bool) -> tuple[float | None, float | None] | None:
    """Return lower and upper end of a range, of that of the opposite number if it `is_turned`."""
    if its is None:
        return None
    low, high = its
    return (low, high) if not is_turned else (None if high is None else 0.0 - high, None if low is None else 0.0 - low)


@dataclass(frozen=True, eq=False)
class JointErrors:
    """The joint covariance (K, K) of the constants, and the field whose parameters they are.

    `field` has the right-hand sides with factors of one as constants; `values` (P,) are those of its parameters,
    `columns` (K,) which of them the constants are, and `signs` (K,) whether the text has a minus before them.
    """

    field: VectorField
    values: FloatArray
    columns: tuple[int, ...]
    signs: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, result: Mapping[str, Any], field: VectorField) -> "JointErrors | None":
        """Return the errors of a result's model, `field` being its right-hand sides; None where they are not known.

        Constants of a diffusion are left out.
        """
        found = result.get("covariance")
        if not found or any(None in row for row in found["matrix"]):
            return None
        names = [*field.states, *field.inputs]
        symbols = list(result["symbols"].values())
        texts, marks, taken = list(field.expressions), {}, 0
        by_variable = {each["variable"]: each for each in result["equations"]}
        of_rates = [place for place, each in enumerate(found["constants"]) if each["variable"] in result["symbols"]]
        rows = [(found["constants"][place]["variable"], found["constants"][place]["constant"]) for place in of_rates]
        for variable in dict.fromkeys(name for name, _ in rows):
            its = [number for name, number in rows if name == variable]
            opened = _opened(Program.from_bytes(bytes.fromhex(by_variable[variable]["program"]), len(symbols)), its)
            if opened is None:
                return None
            places = constant_places(opened.program)
            numbers = [_FIRST_MARK + taken + index for index in range(len(places))]
            values = opened.program.constants[places].tolist()
            for index, (number, value) in enumerate(zip(numbers, values, strict=True)):
                marks[number] = (taken + index, value)
            marked = with_constants(opened.program, dict(zip(places, numbers, strict=True)))
            at = _place(field, symbols[list(result["symbols"]).index(variable)])
            texts[at] = to_infix(marked, symbols)
            taken += len(places)
        opened_field = VectorField(field.states, field.inputs, tuple(texts))
        assert set(names) == set(symbols)
        matrix = np.array(found["matrix"], dtype=np.float64).reshape(len(found["constants"]), -1)
        return cls._matched(opened_field, marks, matrix[np.ix_(of_rates, of_rates)])

    @classmethod
    def _matched(
        cls, field: VectorField, marks: Mapping[float, tuple[int, float]], covariance: FloatArray
    ) -> "JointErrors":
        values = field.values_of_parameters
        columns, signs = [0] * len(marks), np.ones(len(marks))
        for column, parameter in enumerate(field.parameters):
            if abs(parameter.value) in marks:
                row, value = marks[abs(parameter.value)]
                columns[row] = column
                values[column] = value if parameter.value > 0.0 else -value
                signs[row] = 1.0 if parameter.value > 0.0 else -1.0
        return cls(field, values, tuple(columns), signs, covariance)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The variable of the equation of each constant (K,)."""
        return tuple(self.field.parameters[column].variable for column in self.columns)

    def rates(self, x: FloatArray, u: FloatArray | None) -> FloatArray:
        """Return the derivatives (D, K) of the rates by the constants at a point."""
        return self.field.parameter_derivatives(x, u, self.values)[:, list(self.columns)] * self.signs


def _opened(program: Program, origins: Sequence[int | None]) -> ExplicitCoefficients | None:
    """Return the program whose constants, in node order, are these of the covariance; None where there is none."""
    return next(
        (each for each in (make_coefficients_explicit(program), as_written(program)) if [*each.origins] == [*origins]),
        None,
    )


def _place(field: VectorField, symbol: str) -> int:
    """Return which right-hand side is the equation of a state: for order 2, behind those of the positions."""
    position = field.states.index(symbol)
    if field.expressions[position] in field.states:  # the rate of a position is its velocity
        return field.states.index(field.expressions[position])
    return position


def r2_text(value: float | None) -> str:
    """Return R2 in four decimals, never rounded up to 1; ``-`` for None."""
    if value is None:
        return "-"
    return "1" if value == 1.0 else f"{math.floor(value * 1e4) / 1e4:.4f}" if value > -10.0 else f"{value:.2g}"


def interval_text(bounds: Sequence[float | None] | None) -> str:
    """Return ``1.99956 to 2.00019``, with digits that tell the ends apart; ``-`` where an end is not known."""
    low, high = bounds or (None, None)
    if low is None or high is None:
        return "-"
    spread = high - low
    digits = 6 if spread <= 0.0 else 3 + max(0, math.floor(math.log10(max(abs(low), abs(high)) / spread)))
    return f"{low:.{digits}g} to {high:.{digits}g}"
