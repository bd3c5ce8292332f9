"""Several equations as one system that can be integrated and fitted. Pure data.

The programs are concatenated to one tape of nodes. Each fitted constant is a node of the tape. Each fitted number
belongs to one or several constants (`Sharing`). Programs that compute a measured column from the states (observations)
follow the equations on the tape. They are not integrated, but their constants are fitted like all others. Letters: D
equations, M observations, N nodes of all programs, P fitted constants, Q fitted numbers, G groups of trajectories.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from atoll_coordinator.model.shooting.kernels.rates import Tape
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints
from atoll_core.expression.operators import CONSTANT, VARIABLE
from atoll_core.expression.program import Program

Place = tuple[int, int]
"""A constant: (equation, node in this equation)."""

SharedNumber = tuple[tuple[Place, float], ...]
"""The constants that are multiples of one fitted number in all groups of trajectories, each with its multiple."""


@dataclass(frozen=True, eq=False)
class Sharing:
    """The fitted number of each constant in each of G groups of trajectories (G is 1 without groups).

    `constants` (G, N) are the constants of each group's tape. The fitted constant p of group g is the number
    `columns[g, p]` times `multiples[p]`: if groups or constants share a number, they have the same column.
    """

    constants: FloatArray
    columns: Ints
    multiples: FloatArray
    count: int

    @property
    def own_numbers(self) -> int:
        """Number of the Q fitted numbers that belong to one group only."""
        is_own = (self.columns != self.columns[:1]).any(axis=0)
        return int(is_own.sum()) * len(self.columns)

    @property
    def groups(self) -> int:
        """Number of groups G."""
        return len(self.constants)

    def numbers(self, places: Ints) -> FloatArray:
        """Return the fitted numbers (Q,); `places` are the nodes of the constants (P,)."""
        values = np.zeros(self.count)
        values[self.columns] = self.constants[:, places] / self.multiples
        return values

    def ranges(self, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bounds on the fitted numbers (Q,) that keep each constant within its bounds `lower` and `upper`
        (P,)."""
        ends = np.sort([lower / self.multiples, upper / self.multiples], axis=0)
        least, most = np.full(self.count, -np.inf), np.full(self.count, np.inf)
        for columns in self.columns:
            np.maximum.at(least, columns, ends[0])
            np.minimum.at(most, columns, ends[1])
        return least, most


@dataclass(frozen=True, eq=False)
class SearchedParts:
    """The searched programs of a system whose equations were composed with a template.

    `slots` (D) are these programs; where nothing is searched, the slot is the whole right-hand side, and its index is
    in `given`. `nodes` has, for each slot, the node of the tape that holds each of its constants (-1 for other nodes).
    `parameters` (P,) has the node of each parameter; -1 for a parameter of other equations.
    """

    slots: tuple[Program, ...]
    nodes: tuple[Ints, ...]
    parameters: Ints
    given: frozenset[int]


@dataclass(frozen=True, eq=False)
class OdeSystem:
    """D equations and M observations on one tape, see `kernels.rates.Tape`; `equations` are their programs (D + M).

    `parameters` (N,) has, for each node, the index of its fitted constant; it is -1 for nodes without one. `places`
    (P,) are the nodes of the fitted constants, and `owners` (P,) are the indices of their equations; the constants of
    observations come last. `lower` and `upper` (Q,) are bounds on the fitted numbers; None: there are no bounds. With a
    `sharing`, Q may differ from P, and `constants` are the means over the groups. Without a `sharing`, Q is P.
    `outputs` (D,) and `observations` (M,) are the output nodes of the programs. The numbers `is_logarithmic` (Q,) are
    fitted in logarithms; they are not zero. None: there are no such numbers. With `has_prior`, they have the prior
    distribution that their bounds express, see `penalty`. `parts` are the searched programs if the equations were
    composed with a template; None: the equations are the searched programs.
    """

    equations: tuple[Program, ...]
    code: Ints
    left: Ints
    right: Ints
    constants: FloatArray
    outputs: Ints
    parameters: Ints
    owners: Ints
    places: Ints
    lower: FloatArray | None = None
    upper: FloatArray | None = None
    sharing: Sharing | None = None
    parts: SearchedParts | None = None
    observations: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    is_logarithmic: npt.NDArray[np.bool_] | None = None
    has_prior: bool = False

    @property
    def tape(self) -> Tape:
        """The arrays of the nodes of the equations, as arguments of kernels."""
        code, left, right, constants, parameters = self._nodes
        if len(self.observations):
            code, left, right, constants, parameters = self._part(0, int(self.outputs[-1]) + 1)
        return code, left, right, constants, self.outputs, parameters

    @property
    def _nodes(self) -> tuple[Ints, Ints, Ints, FloatArray, Ints]:
        return self.code, self.left, self.right, self.constants, self.parameters

    def _part(self, first: int, end: int) -> tuple[Ints, Ints, Ints, FloatArray, Ints]:
        """Return the arrays of the nodes from `first` up to `end`."""
        part = slice(first, end)
        return self.code[part], self.left[part], self.right[part], self.constants[part], self.parameters[part]

    @property
    def arrays(self) -> list[FloatArray | Ints | npt.NDArray[np.bool_] | None]:
        """All arrays on which a fit of the system depends."""
        arrays = [*self._nodes, self.outputs, self.observations, self.lower, self.upper, self.is_logarithmic]
        arrays.append(np.array([self.has_prior]))
        shared = self.sharing
        return arrays if shared is None else [*arrays, shared.constants, shared.columns, shared.multiples]

    @cached_property
    def firsts(self) -> list[int]:
        """The first node of each program (D + M)."""
        ends = [*self.outputs.tolist(), *self.observations.tolist()]
        return [0, *(end + 1 for end in ends[:-1])]

    def fitted_constants(self, leading: int) -> list[Place]:
        """Return equation and node of each fitted constant; the first `leading` equations are not counted."""
        pairs = zip(self.places.tolist(), self.owners.tolist(), strict=True)
        return [(owner - leading, node - self.firsts[owner]) for node, owner in pairs]

    @cached_property
    def integrated(self) -> int:
        """Number of the P fitted constants that belong to equations; the other constants belong to observations."""
        return int((self.owners < len(self.outputs)).sum())

    @property
    def count(self) -> int:
        """Number Q of fitted numbers."""
        return len(self.places) if self.sharing is None else self.sharing.count

    @property
    def columns(self) -> Ints:
        """The index of the fitted number of each constant, by group and constant (G, P)."""
        return np.arange(len(self.places))[None] if self.sharing is None else self.sharing.columns

    @property
    def multiples(self) -> FloatArray:
        """The ratio (P,) of each constant to its fitted number."""
        return np.ones(len(self.places)) if self.sharing is None else self.sharing.multiples

    @property
    def values(self) -> FloatArray:
        """The fitted numbers (Q,)."""
        return self.constants[self.places] if self.sharing is None else self.sharing.numbers(self.places)

    def with_values(self, values: FloatArray) -> "OdeSystem":
        """Return the system with other values (Q,) of the fitted numbers, within their bounds."""
        if self.lower is not None and self.upper is not None:
            values = np.clip(values, self.lower, self.upper)
        constants = self.constants.copy()
        if self.sharing is None:
            constants[self.places] = values
            return replace(self, constants=constants)
        own = self.sharing.constants.copy()
        own[:, self.places] = self.by_place(values)
        constants[self.places] = own[:, self.places].mean(axis=0)
        return replace(self, constants=constants, sharing=replace(self.sharing, constants=own))

    def moved(self, change: FloatArray) -> "OdeSystem":
        """Return the system after a step (Q,) of the fitted numbers, within their bounds.

        In a step, a number that is fitted in logarithms grows or shrinks by a factor of e at most: beyond it, the
        residuals are far from linear in the logarithm. Such a step has the direction of a step of the logarithms, since
        `least_squares` scales all numbers to the same curvature.
        """
        values = self.values
        if self.is_logarithmic is None:
            return self.with_values(values + change)
        shares = np.clip(change / np.where(self.is_logarithmic, values, 1.0), -1.0, 1.0)
        return self.with_values(np.where(self.is_logarithmic, values * exponentials(shares), values + change))

    def in_logarithms(self) -> "OdeSystem":
        """Return the system with all numbers fitted in logarithms whose two bounds have the same sign."""
        if self.lower is None or self.upper is None:
            return self
        return replace(self, is_logarithmic=self.lower * self.upper > 0.0)

    def penalty(self) -> tuple[float, FloatArray, FloatArray]:
        """Return the penalty of the values by their prior, minus half its gradient (Q,), and half the diagonal of its
        second derivatives (Q,), by Gauss and Newton.

        Bounds of one sign that are finite express a uniform distribution of the logarithm. The prior is the normal
        distribution with the same mean and variance; the penalty is the sum of squared distances from the mean, in
        standard deviations. Without a prior, all are 0.
        """
        values, nothing = self.values, np.zeros(self.count)
        if not self.has_prior or self.is_logarithmic is None or self.lower is None or self.upper is None:
            return 0.0, nothing, nothing
        with np.errstate(all="ignore"):
            low, high = logarithms(np.abs(self.lower)), logarithms(np.abs(self.upper))
            sizes = np.abs(high - low) / np.sqrt(12.0)
            residuals = (logarithms(np.abs(values)) - 0.5 * (low + high)) / sizes
        has_prior = self.is_logarithmic & np.isfinite(residuals)
        residuals, slopes = np.where(has_prior, residuals, 0.0), np.where(has_prior, 1.0 / (sizes * values), 0.0)
        return float((residuals**2).sum()), -residuals * slopes, slopes**2

    def sharing_numbers(self, constants: FloatArray, shared: Collection[SharedNumber], leading: int = 0) -> "OdeSystem":
        """Return the system with one fitted number for each group and constant, except for the `shared` numbers.

        The start value of a shared number is a mean: each of its constants is divided by its multiple, and the mean of
        these quotients is used.

        Args:
            constants: constants of the nodes by group (G, N).
            shared: the constants of each shared number, by equation and node; the first `leading` equations are not
                counted.
        """
        starts = self.firsts[leading:]
        fitted = {node: place for place, node in enumerate(self.places.tolist())}
        together: dict[int, tuple[list[int], list[float]]] = {}
        for number in shared:
            places = [fitted[starts[equation] + node] for (equation, node), _ in number]
            together |= dict.fromkeys(places, (places, [multiple for _, multiple in number]))
        groups, own = len(constants), constants.copy()
        columns = np.full((groups, len(self.places)), -1, np.int64)
        multiples, count = np.ones(len(self.places)), 0
        for place in range(len(self.places)):
            if columns[0, place] >= 0:
                continue
            places, multiples[places] = together.get(place, ([place], [1.0]))
            if place in together:
                nodes = self.places[places]
                own[:, nodes] = (own[:, nodes] / multiples[places]).mean() * multiples[places]
            columns[:, places] = count if place in together else count + np.arange(groups)[:, None]
            count += 1 if place in together else groups
        system = replace(self, sharing=Sharing(own, columns, multiples, count))
        return system.with_values(system.values)

    def blocked_by_bounds(self, gradient: FloatArray) -> npt.NDArray[np.bool_] | None:
        """Return a mask (Q,) of the fitted numbers that lie on a bound, and would cross this bound in a step along
        `gradient` (Q,).

        None if there are no bounds.
        """
        if self.lower is None or self.upper is None:
            return None
        values = self.values
        return ((values <= self.lower) & (gradient <= 0.0)) | ((values >= self.upper) & (gradient >= 0.0))

    @property
    def on_bounds(self) -> npt.NDArray[np.bool_]:
        """A mask (Q,) of the fitted numbers that lie on a bound."""
        if self.lower is None or self.upper is None:
            return np.zeros(self.count, np.bool_)
        values = self.values
        return np.asarray((values <= self.lower) | (values >= self.upper))

    def with_fixed_constants(self) -> "OdeSystem":
        """Return the system with all constants fixed at their values."""
        none = np.zeros(0, dtype=np.int64)
        sharing = self.sharing
        if sharing is not None:
            sharing = Sharing(sharing.constants, np.zeros((sharing.groups, 0), np.int64), np.zeros(0), 0)
        return replace(
            self, parameters=np.full_like(self.parameters, -1), owners=none, places=none, lower=None, upper=None,
            sharing=sharing, is_logarithmic=None, has_prior=False,
        )  # fmt: skip

    def by_place(self, numbers: FloatArray, power: int = 1) -> FloatArray:
        """Return `numbers`, which belong to the Q fitted numbers, by group and constant (G, P); G is one without
        groups.

        Each number is multiplied by the multiple of the constant to the `power`: 1 for values, 2 for variances.
        """
        if self.sharing is None:
            return numbers[None]
        return np.asarray(numbers[self.sharing.columns] * self.sharing.multiples**power)

    def of_group(self, group: int) -> "OdeSystem":
        """Return the system with the constants of one group, without bounds. If there are no groups, the system itself
        is returned."""
        if self.sharing is None:
            return self
        return replace(
            self, constants=self.sharing.constants[group], lower=None, upper=None, sharing=None, is_logarithmic=None,
            has_prior=False,
        )  # fmt: skip

    @property
    def programs(self) -> tuple[Program, ...]:
        """The equations with the constants of the system; the observations follow."""
        parts = np.split(self.constants, self.firsts[1:])
        return tuple(replace(equation, constants=part) for equation, part in zip(self.equations, parts, strict=True))

    def searched(self, leading: int) -> tuple[Program, ...]:
        """Return the searched programs with the constants of the system; the first `leading` equations have none."""
        if self.parts is None:
            return self.programs[leading:]
        return tuple(
            replace(slot, constants=np.where(nodes < 0, slot.constants, self.constants[nodes]))
            for slot, nodes in zip(self.parts.slots, self.parts.nodes, strict=True)
        )

    @property
    def parameter_values(self) -> FloatArray:
        """The values of the parameters of a template; empty without a template, NaN for parameters of other
        equations."""
        if self.parts is None:
            return np.zeros(0)
        nodes = self.parts.parameters
        return np.where(nodes < 0, np.nan, self.constants[nodes])

    @property
    def searched_numbers(self) -> tuple[Ints, FloatArray]:
        """The index of the fitted number, and the multiple, of each fitted constant of the searched programs, one
        program after the other; then of the parameters."""
        if self.parts is None:
            return self.columns[0], self.multiples
        searched = [nodes for index, nodes in enumerate(self.parts.nodes) if index not in self.parts.given]
        fitted = np.concatenate([*searched, self.parts.parameters])
        fitted = fitted[(fitted >= 0) & (self.parameters[fitted] >= 0)]
        return self.columns[0][self.parameters[fitted]], np.ones(len(fitted))

    @property
    def observation_programs(self) -> list[Program]:
        """The observations with the constants of the system, as programs over the components of a point."""
        ends, programs = (self.observations + 1).tolist(), []
        for first, end in zip(self.firsts[len(self.outputs) :], ends, strict=True):
            code, *arguments, constants, _ = self._part(first, end)
            is_leaf = (code == VARIABLE) | (code == CONSTANT)
            left, right = (np.where(is_leaf, of, np.maximum(of - first, 0)).astype(np.int16) for of in arguments)
            programs.append(Program(code.astype(np.int8), left, right, constants))
        return programs


def system_of(
    programs: Sequence[Program], names: Sequence[str], variables: Sequence[str], fixed: Sequence[Collection[int]] = (),
    observations: int = 0,
) -> OdeSystem:  # fmt: skip
    """Return the system of `programs`, one for each equation, then one for each of the `observations`.

    Args:
        programs: programs over `names`, the variables of the dataset.
        names: names of a program's variables, by index.
        variables: names of the components of a point: states with an equation first, then inputs.
        fixed: for each program the nodes whose constants are not fitted.
        observations: number of the last programs that compute a measured column and not a derivative.
    """
    index = {name: place for place, name in enumerate(variables)}
    where = np.array([index.get(name, -1) for name in names], np.int64)
    lengths = [len(program) for program in programs]
    starts = np.cumsum([0, *lengths[:-1]])
    shifts, equations = np.repeat(starts, lengths), np.repeat(np.arange(len(programs)), lengths)
    code, left, right = (
        np.concatenate([getattr(program, name) for program in programs]).astype(np.int64)
        for name in ("operators", "left", "right")
    )
    is_variable, is_fitted = code == VARIABLE, code == CONSTANT
    is_operator = ~is_variable & ~is_fitted
    left = np.where(is_operator, left + shifts, where[np.where(is_variable, left, 0)] * is_variable)
    right = np.where(is_operator, right + shifts, 0)
    for start, length, held in zip(starts.tolist(), lengths, fixed, strict=False):
        is_fitted[[start + node for node in range(length) if node in held]] = False
    places, parameters = np.flatnonzero(is_fitted), np.full(len(code), -1, np.int64)
    parameters[places] = np.arange(len(places))
    constants = np.concatenate([program.constants for program in programs])
    outputs = np.cumsum(lengths) - 1
    count = len(programs) - observations
    return OdeSystem(
        tuple(programs), code, left, right, constants, outputs[:count], parameters, equations[places], places,
        observations=outputs[count:],
    )  # fmt: skip


def variable_program(index: int) -> Program:
    """Return the program that is the variable of this index."""
    return Program(np.array([VARIABLE], np.int8), np.array([index], np.int16), np.zeros(1, np.int16), np.zeros(1))


def logarithms(values: FloatArray) -> FloatArray:
    """Return the logarithms of numbers that are not negative.

    numpy's own function has other last bits on other processors.
    """
    return np.array([math.log(one) if one > 0.0 else -math.inf for one in values.ravel().tolist()]).reshape(
        values.shape
    )


def exponentials(values: FloatArray) -> FloatArray:
    """Return the exponentials, with the same bits on all processors, see `logarithms`."""
    return np.array([math.exp(min(one, 700.0)) for one in values.ravel().tolist()]).reshape(values.shape)
