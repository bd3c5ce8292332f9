"""The core of a model that was found: its result, names, right-hand sides, constants, groups and candidates.

All other packages of the library work on a `ModelCore`. `atoll.Model` (``atoll.api.model``) adds the public methods,
which call these packages. Letters: D states, U inputs.
"""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Self

from atoll.model.equations import (
    DisplayedEquation,
    Parameter,
    differing_groups,
    displayed_equation,
    of_group,
    parameters_of,
    remark_on_groups,
)
from atoll.model.given_sides import GivenSides
from atoll.model.vector_field import JointErrors, VectorField, columns_of
from atoll_coordinator.process_steps.moments import Pair
from atoll_coordinator.result.equations import Candidate, Equation
from atoll_coordinator.result.findings import InputKind
from atoll_coordinator.result.result import Result
from atoll_core.config import JobConfig
from atoll_core.errors import UsageError
from atoll_core.expression.text.parsing import from_infix
from atoll_core.quoting import write_text


class ModelCore:
    """A model: a result in which every equation was found. The public methods are in `atoll.Model`."""

    def __init__(self, result: Result | Mapping[str, object]) -> None:
        """Take a result, or the content of result.json; raises UsageError if it is invalid or lacks an equation."""
        self._result = Result.of(result)
        if not self._result.equations or any(equation.expression is None for equation in self._result.equations):
            raise UsageError("the result lacks an equation, so there is no model; its verdicts give the reasons")

    def __reduce__(self) -> tuple[type[Self], tuple[Result]]:
        """Pickle only the result: functions are compiled again in the other process."""
        return type(self), (self._result,)

    @classmethod
    def from_result(cls, result: Result | Mapping[str, object]) -> Self:
        """Return the model of a result, or of the content of result.json; raises UsageError."""
        return cls(result)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the model of a saved result: of a file, or of a folder with a ``result.json``; raises UsageError."""
        result = Result.load(path)
        try:
            return cls(result)
        except UsageError as error:
            raise UsageError(f"{path}: {error}") from None

    def save(self, path: str | Path) -> None:
        """Write the result as JSON, which `load` and ``coordinator result`` read; raises UsageError."""
        write_text(path, self._result.to_json() + "\n")

    @property
    def result(self) -> Result:
        """The result that the coordinator has written."""
        return self._result

    @property
    def is_regression(self) -> bool:
        """Whether the model is a regression y = f(X), without time."""
        return self._result.kind == "regression"

    @property
    def time(self) -> str:
        """The name of the time column, t if there is none."""
        return self._result.time

    @property
    def states(self) -> tuple[str, ...]:
        """The names of the states in expressions, velocities after positions for order 2; none for a regression."""
        return () if self.is_regression else self.field.states

    @property
    def inputs(self) -> tuple[str, ...]:
        """The names of the inputs in expressions: variables without an equation."""
        return self._result.names if self.is_regression else self.field.inputs

    def input_kind(self, name: str) -> InputKind | None:
        """Return the interpolation of an input between rows of the data; None if it is unknown or not an input."""
        return self._result.columns.input_kinds.get(self._result.columns_by_symbol.get(name, name))

    @cached_property
    def field(self) -> VectorField:
        """The right-hand sides as functions of numbers; raises UsageError for a regression."""
        return VectorField.from_result(self._result)

    @cached_property
    def observed(self) -> VectorField:
        """The measured columns that are computed from states; raises UsageError for a regression."""
        return columns_of(self._result, self.field)

    @property
    def observed_columns(self) -> tuple[str, ...]:
        """The names of the measured columns that are computed from states."""
        return tuple(one.column for one in self._result.observations)

    @cached_property
    def equations(self) -> tuple[DisplayedEquation, ...]:
        """All equations; for a stochastic process also the equations of the diffusion."""
        return tuple(displayed_equation(self._result, equation) for equation in self._result.equations)

    @cached_property
    def params(self) -> dict[str, Parameter]:
        """The constants by name: c1, c2, … in the order of the equations."""
        return parameters_of(self._result)

    @property
    def provenance(self) -> dict[str, object]:
        """The origin of the model: digests of data and result, job, seed, settings, command, versions."""
        result, data = self._result, self._result.data
        named = ("job", "seed", "preset", "config", "command", "versions", "digest")
        origin = {"data": data and data.digest, "files": data and list(data.files), "rows": data and data.rows}
        return origin | {name: getattr(result, name) for name in named}

    @cached_property
    def candidates(self) -> tuple[Self, ...]:
        """The other candidates that were compared, the best first: models that differ from this one in one equation.

        Their constants have no errors. `equations[i].nats` is the Δ description length in nats.
        """
        others = [
            (candidate.nats, place, candidate)
            for place, equation in enumerate(self._result.equations)
            for candidate in equation.candidates
            if not candidate.selected and candidate.nats is not None
        ]
        ranked = sorted(others, key=lambda other: other[0])
        return tuple(type(self)(_with_candidate(self._result, place, other)) for _, place, other in ranked)

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of trajectories that differ in constants; empty if all share one set of constants."""
        return differing_groups(self._result)

    def of_group(self, group: object) -> Self:
        """Return the model with the constants of one of the `groups`; raises UsageError for an unknown group."""
        name = str(group)
        if name not in self.groups:
            without_groups = "the model has no groups, but one set of constants for all trajectories"
            known_groups = f"the groups are {', '.join(self.groups)}" if self.groups else without_groups
            raise UsageError(f"there is no group {name!r}; {known_groups}")
        return type(self)(of_group(self._result, next(known for known in self._result.groups if known.group == name)))

    def require_one_group(self) -> None:
        """Raise UsageError if constants differ between groups."""
        if self.groups:
            listed = ", ".join(self.groups)
            raise UsageError(
                f"constants of this model may differ between its groups ({listed})",
                python="choose one with of_group",
                command="choose one with --group",
            )

    @property
    def remark(self) -> str:
        """A remark that constants of the displayed equations are means over groups; "" without groups."""
        return remark_on_groups(self._result)

    def __eq__(self, other: object) -> bool:
        """Models with equal results are equal, such as a saved and a loaded model."""
        return self._result == other._result if isinstance(other, ModelCore) else NotImplemented

    def __hash__(self) -> int:
        return hash((self._result.digest, str(self)))

    def __repr__(self) -> str:
        return "\n".join([*map(str, self.equations), *filter(None, [self.remark])])

    @cached_property
    def components(self) -> dict[str, Pair]:
        """The equations of the diffusion matrix g gᵀ of a process dx = f dt + g dW: row and column, by name."""
        columns = [*enumerate(self.result.columns_by_symbol[name] for name in self.states)]
        pairs = {f"[{name}]": (place, place) for place, name in columns}
        pairs |= {f"[{first},{second}]": (i, j) for i, first in columns for j, second in columns if i < j}
        named = [equation.variable for equation in self.result.equations]
        return {name: pairs[name] for name in named if name in pairs}

    @cached_property
    def joint_errors(self) -> JointErrors | None:
        return JointErrors.of(self._result, self.field)

    @property
    def degrees_of_freedom(self) -> float | None:
        known = self._result.covariance or next((group.covariance for group in self._result.groups), None)
        return None if known is None else known.freedom


_SEARCH_FIELDS = (
    "error", "normalized_error", "r2", "converged", "simple_together", "epoch", "generation", "point_evaluations",
    "point_evaluations_by_part", "seconds", "why", "derivative_floor", "target_error", "convergence", "front",
)  # fmt: skip
"""Fields that belong to the search and not to the displayed equation: a candidate keeps them."""


def config_of(result: Result) -> JobConfig:
    """Return the configuration of the job of a result."""
    return JobConfig.model_validate({"preset": result.preset or "default", **result.config})


def _with_candidate(result: Result, place: int, other: Candidate) -> Result:
    """Return the result with a candidate instead of equation `place`, without errors, verdicts and shared terms."""
    # constants of candidates are fitted to all groups together; so are the constants of the other equations here
    equations = [
        equation.model_copy(update={"groups": (), "is_of_all_groups": bool(equation.groups)})
        for equation in result.equations
    ]
    replaced = result.equations[place]
    equations[place] = Equation(
        variable=replaced.variable,
        lhs=replaced.lhs,
        **{name: getattr(other, name) for name in ("expression", "complexity", "origin", "nats")},
        **{name: getattr(replaced, name) for name in _SEARCH_FIELDS},
        is_of_all_groups=result.group is not None or bool(replaced.groups),
    )
    if other.unknown is not None:
        equations[place] = equations[place].model_copy(update={"given": replaced.given})
        sides = GivenSides.of(result).with_candidate(place, from_infix(other.unknown, result.names), other.parameters)
        equations = [
            sides.describe(equation, index, result.equations[index].constants)
            if equation.given is not None
            else equation
            for index, equation in enumerate(equations)
        ]
    unknown = {"covariance": None, "groups": (), "correlations": (), "shared_terms": (), "chaos": None}
    return result.model_copy(update={"equations": tuple(equations), **unknown})
