"""A model that was found: equations, constants, simulations, scores, candidates, provenance.

`Model` is the public class. Its methods that analyse, plan, display and export are in ``shortcuts``. Letters: D states,
U inputs, N rows or times.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Literal, overload

import numpy as np
import numpy.typing as npt

from atoll.model.arguments import (
    Columns,
    Given,
    GivenInputs,
    by_name,
    column,
    has,
    has_columns,
    inputs_along,
    number,
    points_of,
    read_columns,
    recorded_inputs,
    require_inputs,
    rows_of,
    stacked,
    start_of,
    times_of,
)
from atoll.model.equations import (
    LEVEL,
    DisplayedEquation,
    Parameter,
    differing_groups,
    displayed_equation,
    measured_ranges,
    of_group,
    outside_sentence,
    parameters_of,
    quantile,
    remark_on_groups,
)
from atoll.model.shortcuts import Shortcuts, write_text
from atoll.model.simulation import (
    EarlyEndWarning,
    ExtrapolationWarning,
    Inputs,
    Simulation,
    SimulationWarning,
    density_of_process,
    ensemble_of,
    process_of,
    simulate,
)
from atoll.model.vector_field import JointErrors, VectorField
from atoll_coordinator.result.equations import Candidate, Equation
from atoll_coordinator.result.findings import InputKind
from atoll_coordinator.result.result import Result
from atoll_coordinator.stochastic.moments import Pair
from atoll_coordinator.stochastic.paths import PATHS, Ensemble, StationaryDensity
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from atoll_core.quoting import shown


class Model(Shortcuts):
    """A model as users hold it: the result of a job that has found every equation, with methods to use it."""

    def __init__(self, result: Result | Mapping[str, object]) -> None:
        """Take a result, or the content of result.json; raises UsageError if it is invalid or lacks an equation."""
        self._result = Result.of(result)
        if not self._result.equations or any(equation.expression is None for equation in self._result.equations):
            raise UsageError("the result has not found every equation, so there is no model; look at its verdicts")

    def __reduce__(self) -> tuple[type["Model"], tuple[Result]]:
        """Pickle only the result: functions are compiled again in the other process."""
        return type(self), (self._result,)

    @classmethod
    def from_result(cls, result: Result | Mapping[str, object]) -> "Model":
        """Return the model of a result, or of the content of result.json; raises UsageError."""
        return cls(result)

    @classmethod
    def load(cls, path: str | Path) -> "Model":
        """Return the model of a saved result, by its file or the folder of its ``result.json``; raises UsageError."""
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
        """Whether it is y = f(X), without time."""
        return self._result.kind == "regression"

    @property
    def time(self) -> str:
        """The name of the time column, t where it has none."""
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
        """Return the interpolation of an input between rows of the data, None where it is not known or not an input."""
        return self._result.columns.input_kinds.get(self._result.columns_by_symbol.get(name, name))

    @cached_property
    def field(self) -> VectorField:
        """The right-hand sides as functions of numbers; raises UsageError for a regression."""
        return VectorField.from_result(self._result)

    @cached_property
    def equations(self) -> tuple[DisplayedEquation, ...]:
        """All equations, for a stochastic process including the diffusion."""
        return tuple(displayed_equation(self._result, equation) for equation in self._result.equations)

    @cached_property
    def params(self) -> dict[str, Parameter]:
        """The constants by name: c1, c2, … in the order of the equations."""
        return parameters_of(self._result)

    def conf_int(
        self, level: float = LEVEL, method: Literal["stderr", "profile"] = "stderr"
    ) -> dict[str, tuple[float, float] | None]:
        """Return the confidence interval of each constant at `level`, None where it is not known.

        It follows from the standard error, or from the `profile`: then an end that the data do not bound is infinite.
        """
        if not 0.0 < number(level, "a level") < 1.0:
            raise UsageError(f"a level lies between 0 and 1, but {level!r} was given")
        if method not in ("stderr", "profile"):
            raise UsageError(f"the method of an interval is 'stderr' or 'profile', but {method!r} was given")
        if method == "profile":
            known = self.profile(level)
            return {name: known[name].interval if name in known else None for name in self.params}
        return {name: parameter.interval_at(level, self._degrees_of_freedom) for name, parameter in self.params.items()}

    @property
    def provenance(self) -> dict[str, object]:
        """The origin of the model: digests of data and result, job, seed, settings, command, versions."""
        result, data = self._result, self._result.data
        named = ("job", "seed", "preset", "config", "command", "versions", "digest")
        origin = {"data": data and data.digest, "files": data and list(data.files), "rows": data and data.rows}
        return origin | {name: getattr(result, name) for name in named}

    @cached_property
    def candidates(self) -> tuple["Model", ...]:
        """The other equations that were compared, each as a model with the rest of this one, the best first.

        Their constants have no errors; `equations[i].nats` is the Δ description length.
        """
        others = [
            (candidate.nats, place, candidate)
            for place, equation in enumerate(self._result.equations)
            for candidate in equation.candidates
            if not candidate.selected and candidate.nats is not None
        ]
        ranked = sorted(others, key=lambda other: other[0])
        return tuple(Model(_with_candidate(self._result, place, other)) for _, place, other in ranked)

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of trajectories that differ in constants; empty where there is one set of constants."""
        return differing_groups(self._result)

    def of_group(self, group: object) -> "Model":
        """Return the model with the constants of one of the `groups`; raises UsageError for another one."""
        name = str(group)
        if name not in self.groups:
            alone = "the model has no groups, but one set of constants for all trajectories"
            there = f"the groups are {', '.join(self.groups)}" if self.groups else alone
            raise UsageError(f"there is no group {name!r}; {there}")
        return Model(of_group(self._result, next(known for known in self._result.groups if known.group == name)))

    def require_one_group(self) -> None:
        """Raise UsageError where constants differ between groups."""
        if self.groups:
            listed = ", ".join(self.groups)
            raise UsageError(
                f"constants of this model may differ between its groups ({listed})",
                python="choose one with of_group",
                command="choose one with --group",
            )

    @property
    def remark(self) -> str:
        """A remark on the displayed equations: constants are means over groups; "" without groups."""
        return remark_on_groups(self._result)

    def __eq__(self, other: object) -> bool:
        """Models with equal results are equal, such as a saved and a loaded model."""
        return self._result == other._result if isinstance(other, Model) else NotImplemented

    def __hash__(self) -> int:
        return hash((self._result.digest, str(self)))

    def __repr__(self) -> str:
        return "\n".join([*map(str, self.equations), *filter(None, [self.remark])])

    @overload
    def simulate(
        self,
        x0: Given | None = None,
        t: npt.ArrayLike | float | None = None,
        u: GivenInputs = None,
        *,
        has_bands: bool = True,
        group: object = None,
        paths: None = None,
        seed: int = 0,
    ) -> Simulation: ...

    @overload
    def simulate(
        self,
        x0: Given | None = None,
        t: npt.ArrayLike | float | None = None,
        u: GivenInputs = None,
        *,
        has_bands: bool = True,
        group: object = None,
        paths: int,
        seed: int = 0,
    ) -> Ensemble: ...

    def simulate(  # noqa: PLR0913, the keywords are the options of the command
        self,
        x0: Given | None = None,
        t: npt.ArrayLike | float | None = None,
        u: GivenInputs = None,
        *,
        has_bands: bool = True,
        group: object = None,
        paths: int | None = None,
        seed: int = 0,
    ) -> Simulation | Ensemble:
        """Integrate from an initial state. Its `status` says how it ends: a blow-up is a result, not an error.

        One that ends early has only the times that were reached, and an `EarlyEndWarning` says so. An
        `ExtrapolationWarning` says that `x0` is outside of the measured range.

        Args:
            x0: the initial state, by name or in order, angles in radians; None: of the first measured trajectory, with
                its inputs where `u` names none.
            t: ascending times, the first one at `x0`; one number: the last time, from the first measured one; None: the
                times of the first trajectory.
            u: inputs: by name numbers, arrays at the times `t` or functions of time; or an array (N, U), or a function
                of time that returns U numbers. An input that is the time itself is not given.
            has_bands: whether errors of the constants are propagated to 95 % bands, where they are known.
            group: the group of trajectories whose constants are used, where these differ; one of `groups`.
            paths: for a stochastic process, the number of paths to draw: an `Ensemble`. None: the drift alone.
            seed: of the paths; the same seed gives the same paths.

        Raises:
            UsageError: the arguments do not fit, the model has no time, constants differ between groups and none is
                named, or paths are requested of a model without noise.
        """
        model = self if group is None else self.of_group(group)
        model.require_one_group()
        if paths is not None:
            process_of(model)
        field, times, start = model.field, times_of(model, t), start_of(model, x0)
        inputs = inputs_along(model, u, times, recorded_inputs(model) if x0 is None else {})
        remark = "" if x0 is None else _extrapolated(model, start, None if u is None else inputs, float(times[0]))
        if remark:
            warnings.warn(remark, ExtrapolationWarning, stacklevel=2)
        if paths is not None:
            return ensemble_of(model, start, times, inputs, (paths, seed))
        errors = model._errors if has_bands else None
        bands = None if errors is None else (errors, quantile(LEVEL, model._degrees_of_freedom))
        simulation = replace(simulate(field, start, times, inputs, bands), time=model.time, remark=remark)
        if len(simulation.t) < len(times):
            warnings.warn(simulation.message, EarlyEndWarning, stacklevel=2)
        return simulation

    def stationary_density(
        self,
        x0: Given | None = None,
        *,
        inputs: Mapping[str, float] | None = None,
        paths: int = PATHS,
        seed: int = 0,
    ) -> StationaryDensity | None:
        """Return the stationary density of the paths of a stochastic process; None where they do not settle.

        Paths that stay in one of two wells for the whole simulation give the density in that well.

        Args:
            x0: the initial state of all paths; None: as measured.
            inputs: held values of inputs, by name; 0 by default.
            paths: the number of paths, at least 2.
            seed: of the paths.

        Raises:
            UsageError: the arguments do not fit, or the model has no noise.
        """
        process_of(self)
        named = {name: number(value, f"the input {name!r}") for name, value in by_name(inputs, "inputs").items()}
        require_inputs(self, named)
        held = {self.result.symbols.get(name, name): value for name, value in named.items()}
        return density_of_process(
            self, start_of(self, x0), [held.get(name, 0.0) for name in self.inputs], (paths, seed)
        )

    @cached_property
    def components(self) -> dict[str, Pair]:
        """The equations of the diffusion g g' of a process dx = f dt + g dW: the indices of both states, by name."""
        columns = [*enumerate(self.result.columns_by_symbol[name] for name in self.states)]
        pairs = {f"[{name}]": (place, place) for place, name in columns}
        pairs |= {f"[{first},{second}]": (i, j) for i, first in columns for j, second in columns if i < j}
        named = [equation.variable for equation in self.result.equations]
        return {name: pairs[name] for name in named if name in pairs}

    def predict(self, x: Columns | npt.ArrayLike, u: Columns | npt.ArrayLike | None = None) -> FloatArray:
        """Return the derivatives at rows of states, or the target of a regression.

        Args:
            x: (N, D) states, or columns by name (also a frame of pandas or polars); (N, U) inputs of a regression.
                Columns are read as in the fit, with angles in degrees if they were; arrays have angles in radians.
            u: (N, U) inputs; None where there are none, or where `x` has them by name.

        Returns:
            (N, D) derivatives, (N,) values of a regression; NaN where undefined.
        """
        self.require_one_group()
        x = read_columns(self, x) if has_columns(x) else x
        u = read_columns(self, u) if has_columns(u) else u
        if self.is_regression:
            program = from_infix(self.equations[0].exact, self.result.names)
            values = values_of(program, np.ascontiguousarray(points_of(self, x, self.inputs).T))
            return np.asarray(np.where(np.isfinite(values), values, np.nan))
        points = points_of(self, x, self.states)
        if not self.inputs:
            return self.field.values(points)
        given = u if u is not None else (x if has_columns(x) else None)
        if given is None:
            raise UsageError(f"the model has the inputs {', '.join(self.inputs)}; give their values as u")
        held = points_of(self, given, self.inputs)
        if len(held) != len(points):
            raise UsageError(f"there are {len(held)} rows of inputs for {len(points)} of states; give one for each")
        return self.field.values(points, held)

    def score(self, data: Columns | Sequence[Columns]) -> float:
        """Return R2 on data: columns by name (also a frame), or a list of these, one for each trajectory.

        A model of dynamics is simulated from the first row of each trajectory; R2 is the mean over the measured states,
        and minus infinity where a simulation does not reach the end. A regression is judged by its target.
        """
        self.require_one_group()
        given: list[object] = [*data] if isinstance(data, (list, tuple)) else [data]
        parts = [read_columns(self, part) for part in given if has_columns(part)]
        if not given or len(parts) < len(given):
            raise UsageError(f"a score takes columns by name, a frame or a list of these, but {shown(data)} was given")
        if self.is_regression:
            target = self._result.equations[0].variable
            both = [stacked([column(part, target), self.predict(part)]) for part in parts]
            return _r2(*np.concatenate(both, axis=1))
        columns = self._result.columns_by_symbol
        states = [name for name in self.states if all(has(part, columns[name]) for part in parts)]
        if not states:
            names = ", ".join(columns[name] for name in self.states)
            raise UsageError(f"the data have none of the columns {names} in every part; give a measured state")
        simulated, measured = [], []
        for part in parts:
            times, _, start = rows_of(self, part)
            inputs = {name: column(part, columns[name]) for name in self.inputs}
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", SimulationWarning)
                simulation = self.simulate(start, times, inputs or None, has_bands=False)
            if simulation.status != "finished":
                return -np.inf
            simulated.append(stacked([simulation[name] for name in states]))
            measured.append(stacked([column(part, columns[name]) for name in states]))
        pairs = zip(np.concatenate(measured, axis=1), np.concatenate(simulated, axis=1), strict=True)
        return float(np.mean([_r2(rows, values) for rows, values in pairs]))

    @cached_property
    def _errors(self) -> JointErrors | None:
        return JointErrors.of(self._result, self.field)

    @property
    def _degrees_of_freedom(self) -> float | None:
        known = self._result.covariance or next((group.covariance for group in self._result.groups), None)
        return None if known is None else known.freedom


def _extrapolated(model: Model, start: FloatArray, inputs: Inputs | None, time: float) -> str:
    """Return a sentence on states of `start` (D,), and inputs then, outside of the measured range; "" without."""
    values = dict(zip(model.states, start.tolist(), strict=True))
    if inputs is not None:
        clock = model.result.symbols.get(model.time)
        driven = zip(model.inputs, np.asarray(inputs(time), dtype=np.float64).tolist(), strict=True)
        values |= {name: value for name, value in driven if name != clock}
    return outside_sentence(values, measured_ranges(model.result))


_OF_THE_SEARCH = (
    "error", "normalized_error", "r2", "converged", "simple_together", "epoch", "generation", "point_evaluations",
    "point_evaluations_by_part", "seconds", "why", "derivative_floor", "target_error", "convergence", "front",
)  # fmt: skip
"""Fields that belong to the search and not to the displayed equation: a candidate keeps them."""


def _with_candidate(result: Result, place: int, other: Candidate) -> Result:
    """Return the result with a candidate instead of an equation, without errors, verdicts and shared terms."""
    # constants of candidates, and of equations without their groups, belong to all groups together
    equations = [
        equation.model_copy(update={"groups": (), "is_of_all_groups": bool(equation.groups)})
        for equation in result.equations
    ]
    shown_equation = result.equations[place]
    equations[place] = Equation(
        variable=shown_equation.variable,
        lhs=shown_equation.lhs,
        **{name: getattr(other, name) for name in ("expression", "complexity", "origin", "nats")},
        **{name: getattr(shown_equation, name) for name in _OF_THE_SEARCH},
        is_of_all_groups=result.group is not None or bool(shown_equation.groups),
    )
    unknown = {"covariance": None, "groups": (), "correlations": (), "shared_terms": (), "chaos": None}
    return result.model_copy(update={"equations": tuple(equations), **unknown})


def _r2(measured: FloatArray, values: FloatArray) -> float:
    known = np.isfinite(measured)
    residual = float(((measured - values)[known] ** 2).sum())
    spread = float(((measured[known] - measured[known].mean()) ** 2).sum())
    return 1.0 - residual / spread if spread > 0.0 else (1.0 if residual == 0.0 else -np.inf)
