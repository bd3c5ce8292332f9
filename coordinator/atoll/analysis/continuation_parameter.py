"""What varies along a continuation: constants, factors of one that nobody writes, or an input.

A constant is named as it stands in the equations (c1, c2, …), or by the term that it is the coefficient of: in
dy/dt = y*(2 - x - y) the coefficient of ``x*y`` is one that nobody writes. Letters: D states, P parameters, U inputs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from atoll.analysis.flow import Flow
from atoll.model.vector_field import VectorField
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import ARITY, CONSTANT
from atoll_core.expression.program import Program, ProgramBuilder, constant_places
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.unit_coefficients import make_coefficients_explicit

_POINTS: Final = 32
"""Points at which a term and the derivative by a constant are compared; two that agree at all of them are the same."""

_SAME: Final = 1e-9
"""Share of the term by which rounding may make them differ."""


@dataclass(frozen=True, eq=False)
class ContinuationParameter:
    """A number that varies: the parameters (indices) go with it in the ratios `factors`, the inputs are it.

    `value` is that of the model, and `name` what users call it.
    """

    name: str
    value: float
    parameters: tuple[int, ...] = ()
    factors: tuple[float, ...] = ()
    inputs: tuple[int, ...] = ()

    def at(self, flow: Flow, value: float) -> Flow:
        """Return the flow at another value."""
        parameters, inputs = flow.parameters.copy(), flow.inputs.copy()
        parameters[list(self.parameters)] = value * np.array(self.factors)
        inputs[list(self.inputs)] = value
        return replace(flow, parameters=parameters, inputs=inputs)

    def slope(self, flow: Flow, x: FloatArray) -> FloatArray:
        """Return the derivative of the rates at points (N, D) by the value, (N, D)."""
        derivative = np.zeros(x.shape)
        if self.parameters:
            derivative = derivative + flow.by_parameters(x)[..., list(self.parameters)] @ np.array(self.factors)
        if self.inputs:
            derivative = derivative + flow.by_inputs(x)[..., list(self.inputs)].sum(axis=-1)
        return derivative


@dataclass(frozen=True, eq=False)
class Coefficients:
    """The numbers of a field that can be varied: all constants and factors of one are parameters of `explicit`.

    `origins` has for each of these its index among the parameters of `field`, None for a factor of one.
    """

    field: VectorField
    explicit: VectorField
    origins: tuple[int | None, ...]

    @classmethod
    def of(cls, field: VectorField) -> "Coefficients":
        """Return those of a field."""
        programs: list[Program] = []
        origins: list[int | None] = []
        begin = 0
        for program in field.programs:
            explicit = make_coefficients_explicit(program)
            apart, own = _apart(explicit.program, explicit.origins)
            programs.append(apart)
            origins += [None if origin is None else begin + origin for origin in own]
            begin += len(constant_places(program))
        return cls(field, replace(field, programs=tuple(programs)), tuple(origins))

    @cached_property
    def units(self) -> tuple[str, ...]:
        """The names of the factors of one that nobody writes: ``y:x*y`` is the coefficient of x*y in dy/dt."""
        values = self._values(self.field.values_of_parameters)
        return tuple(
            f"{parameter.variable}:{self.explicit.term_of(index, values)}"
            for index, (parameter, origin) in enumerate(zip(self.explicit.parameters, self.origins, strict=True))
            if origin is None
        )

    def find(self, flow: Flow, name: str) -> tuple[Flow, ContinuationParameter]:
        """Return a flow, and what of it varies, by name: constants (several with commas), a term, or an input.

        Constants that are named together keep their ratios to the first. Raises UsageError where there is no such
        constant, term or input.
        """
        if name in flow.field.inputs:
            place = flow.field.inputs.index(name)
            return flow, ContinuationParameter(name, float(flow.inputs[place]), inputs=(place,))
        parts = [part.strip() for part in name.split(",")]
        indices = [index for part in parts for index in self._indices(part)]
        values = self._values(flow.parameters)
        written = [float(values[index]) for index in indices]
        if written[0] == 0.0 and any(written):
            raise UsageError(f"{parts[0]} is 0, so that the others have no ratio to it; name another one first")
        factors = tuple(value / written[0] if written[0] else 1.0 for value in written)
        varied = replace(flow, field=self.explicit, parameters=values)
        return varied, ContinuationParameter(name, written[0], tuple(indices), factors)

    def _values(self, parameters: FloatArray) -> FloatArray:
        """Return the values of the parameters of `explicit`."""
        return np.array([1.0 if origin is None else float(parameters[origin]) for origin in self.origins])

    def _indices(self, name: str) -> list[int]:
        """Return which parameters of `explicit` are meant: all uses of one constant, or the coefficient of one term."""
        constants = self.field.parameters
        numbered = enumerate(constants)
        origin = next((index for index, constant in numbered if name in (constant.name, str(index + 1))), None)
        if origin is not None:
            return [index for index, own_origin in enumerate(self.origins) if own_origin == origin]
        indices = self._of_term(name)
        if len(indices) == 1:
            return indices
        fault = f"'{name}' stands in several equations" if indices else f"there is no parameter '{name}'"
        known = ", ".join(f"{constant.name} = {constant.value:g} of {constant.variable}" for constant in constants)
        others = [*self.units, *self.field.inputs]
        more = f", and can vary {', '.join(others)}" if others else ""
        raise UsageError(f"{fault}; the model has {known or 'no constants'}{more}")

    def _of_term(self, name: str) -> list[int]:
        """Return the parameters whose derivative is a term, given as ``x*y`` or, with its equation, ``y:x*y``."""
        names = (*self.field.states, *self.field.inputs)
        variable, separator, text = name.rpartition(":")
        try:
            program = from_infix(text, names)
        except UsageError:
            return []
        points = np.random.default_rng(0).uniform(0.5, 1.5, (_POINTS, len(names)))
        values = values_of(program, np.ascontiguousarray(points.T))
        states, inputs = points[:, : len(self.field.states)], points[:, len(self.field.states) :]
        own = self._values(self.field.values_of_parameters)
        slopes = self.explicit.parameter_derivatives(states, inputs, own)
        indices = []
        for index, constant in enumerate(self.explicit.parameters):
            slope = slopes[:, self.explicit.states.index(constant.variable), index]
            apart = min(np.abs(slope - values).max(), np.abs(slope + values).max())
            if (not separator or variable == constant.variable) and apart <= _SAME * np.abs(values).max():
                indices.append(index)
        return indices


def _apart(program: Program, origins: Sequence[int | None]) -> tuple[Program, tuple[int | None, ...]]:
    """Return a program in which each use of a constant is one of its own, with the origins of these in node order."""
    nodes, builder = program.nodes(), ProgramBuilder()
    numbers = dict(zip(constant_places(program), origins, strict=True))
    used: dict[int, int | None] = {}
    places: list[int] = []

    def use(old: int) -> int:
        if nodes[old][0] != CONSTANT:
            return places[old]
        new = builder.append(CONSTANT, value=nodes[old][3])
        used[new] = numbers[old]
        return new

    for code, left, right, value in nodes:
        if code == CONSTANT:
            places.append(-1)  # copied where it is used
        elif ARITY[code]:
            places.append(builder.append(code, use(left), use(right) if ARITY[code] == 2 else 0))
        else:
            places.append(builder.append(code, left, right, value))
    return builder.program(use(len(nodes) - 1)), tuple(used.values())
