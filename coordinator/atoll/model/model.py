"""A model that was found, with what is known of it: equations, constants, simulations, provenance.

Letters: D states, U inputs, N rows or times.
"""

import json
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, overload

import numpy as np
import numpy.typing as npt

from atoll.model.arguments import by_name, interval, number, numbers
from atoll.model.ensembles import density_of_process, ensemble_of, require_process
from atoll.model.export.methods import Exports
from atoll.model.parameters import (
    LEVEL,
    JointErrors,
    Parameter,
    differing_groups,
    of_group,
    parameters_of,
    remark_on_groups,
)
from atoll.model.saved import check_result, read_result, write_text
from atoll.model.simulation import EarlyEndWarning, Inputs, Simulation, interpolated, simulate, together
from atoll.model.vector_field import VectorField
from atoll_coordinator.stochastic.densities import StationaryDensity
from atoll_coordinator.stochastic.moments import Pair
from atoll_coordinator.stochastic.paths import PATHS, Ensemble
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.hints import did_you_mean
from atoll_core.quoting import shown

if TYPE_CHECKING:
    import sympy

    from atoll.analysis.analysis import Analysis
    from atoll.experiments.determination import Identifiability, ProfiledConstant
    from atoll.experiments.suggestion import Cost, Suggestions

DIGITS: Final = 6
"""Significant digits of the constants that people are shown."""
ROWS: Final = 501
"""Times of a simulation whose end alone is given."""

_COMPOUND: Final = re.compile(r"[\s*/^.·⋅×⁻¹²³]|\d")
"""What a unit of several factors or with a power has."""

Given = Mapping[str, Any] | Sequence[float] | FloatArray
"""Numbers by name, or in the order of the states or inputs."""


@dataclass(frozen=True)
class Equation:
    """One equation: `lhs` = `expression`, for people with rounded constants; `exact` is the text to the last bit.

    `unit` is that of the left-hand side, "" where columns have none. `verdict` and `reason` say how far to trust it.
    """

    variable: str
    lhs: str
    expression: str
    exact: str
    unit: str = ""
    verdict: str | None = None
    reason: str | None = None
    complexity: int | None = None
    nats: float = 0.0

    def __str__(self) -> str:
        return f"{self.lhs} = {self.expression}" + (f"  [{self.unit}]" if self.unit else "")


class Model(Exports):
    """A model as users hold it: read from the content of ``result.json``, which it keeps and can write again."""

    def __init__(self, result: Mapping[str, Any]) -> None:
        """Take the content of result.json; raises UsageError when it is none, or of another version."""
        found = check_result(dict(result) if isinstance(result, Mapping) else result)
        if not found["equations"] or any(each.get("expression") is None for each in found["equations"]):
            raise UsageError("the result has not found every equation, so there is no model; look at its verdicts")
        self._result = found

    def __reduce__(self) -> tuple[type["Model"], tuple[dict[str, Any]]]:
        """Go to another process as the result alone: compiled functions, made when first needed, stay behind."""
        return type(self), (self._result,)

    @classmethod
    def from_result(cls, result: Mapping[str, Any]) -> "Model":
        """Return the model of a result (the content of result.json); raises UsageError."""
        return cls(result)

    @classmethod
    def load(cls, path: str | Path) -> "Model":
        """Return the model of a saved result, by its file or the folder of its ``result.json``.

        Raises UsageError when the file cannot be read or holds none.
        """
        found = read_result(path)
        try:
            return cls(found)
        except UsageError as error:
            raise UsageError(f"{path}: {error}") from None

    def save(self, path: str | Path) -> None:
        """Write the result as JSON, which `load` and ``coordinator result`` read; raises UsageError."""
        write_text(path, json.dumps(self._result, ensure_ascii=False, allow_nan=False) + "\n")

    # ------------------------------------------------------------------------------------------- what it is

    @property
    def result(self) -> dict[str, Any]:
        """The content of result.json."""
        return self._result

    @property
    def is_regression(self) -> bool:
        """Whether it is y = f(X), without time."""
        kind = (self._result.get("system") or {}).get("kind")
        if kind is not None:
            return bool(kind == "regression")
        return all("/" not in each["lhs"] for each in self._result["equations"])

    @property
    def time(self) -> str:
        """The name of the time column, t where it has none."""
        return str((self._result.get("system") or {}).get("time") or "t")

    @property
    def states(self) -> tuple[str, ...]:
        """The names of the states in expressions, velocities behind positions for order 2; none of a regression."""
        return () if self.is_regression else self.field.states

    @property
    def inputs(self) -> tuple[str, ...]:
        """The names of the inputs in expressions: variables without an equation."""
        return self._names if self.is_regression else self.field.inputs

    @cached_property
    def field(self) -> VectorField:
        """The right-hand sides as functions of numbers; raises UsageError where there is no time."""
        return VectorField.from_result(self._result)

    @cached_property
    def equations(self) -> tuple[Equation, ...]:
        """All equations; of a stochastic process those of the diffusion as well."""
        units = (self._result.get("system") or {}).get("units") or {}
        return tuple(
            Equation(
                each["variable"],
                each["lhs"],
                to_infix(from_infix(each["expression"], self._names), self._names, digits=DIGITS),
                each["expression"],
                _unit(each["variable"], each["lhs"], units, None if self.is_regression else self.time),
                each.get("verdict"),
                each.get("reason"),
                each.get("complexity"),
                float(each.get("nats") or 0.0),
            )
            for each in self._result["equations"]
        )

    @cached_property
    def params(self) -> dict[str, Parameter]:
        """The constants by name: c1, c2, … as they stand in the equations, one after the other."""
        return parameters_of(self._result, self._result["equations"])

    def conf_int(
        self, level: float = LEVEL, method: Literal["stderr", "profile"] = "stderr"
    ) -> dict[str, tuple[float, float] | None]:
        """Return the confidence interval of each constant at `level`, None where it is not known.

        By its standard error, or by its `profile`: then an end that the data leave open is infinite.
        """
        if not 0.0 < number(level, "a level") < 1.0:
            raise UsageError(f"a level lies between 0 and 1, but {level!r} was given")
        if method not in ("stderr", "profile"):
            raise UsageError(f"the method of an interval is 'stderr' or 'profile', but {method!r} was given")
        if method == "profile":
            known = self.profile(level)
            return {name: known[name].interval if name in known else None for name in self.params}
        return {name: each.interval_at(level, self._freedom) for name, each in self.params.items()}

    def profile(self, level: float = LEVEL, data: Any = None) -> "dict[str, ProfiledConstant]":
        """Return the profile likelihood of each constant, by name; see `identifiability`."""
        return {each.name: each for each in self.identifiability(level, data).constants}

    def identifiability(self, level: float = LEVEL, data: Any = None) -> "Identifiability":
        """Return what the data determine of each constant, and which of them only together.

        Args:
            level: of the intervals.
            data: as of `atoll.discover`, in the place of the measurements that the result has.

        Raises:
            UsageError: states were not measured in time, or the result does not have the measurements.
            DataError: the data cannot be used as they are.
        """
        self.require_one_group()
        found: Identifiability = _experiments().identifiability(self._result, data, level)
        return found

    def suggest(  # noqa: PLR0913, the keywords are the options of the command
        self,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        *,
        duration: float | None = None,
        samples: int | None = None,
        cost: "Cost" = "trajectory",
        count: int = 3,
        rivals: Mapping[str, str] | Sequence[Mapping[str, str]] = (),
        seed: int = 0,
        data: Any = None,
    ) -> "Suggestions":
        """Return the experiments to make next: those that tell most about which candidate is right, for their cost.

        Where candidates do not differ, or there is only one, those that determine its constants best.

        Args:
            bounds: of initial states and constant inputs, by name; None: the range of the data.
            duration: of an experiment; None: that of the median trajectory that was measured.
            samples: measurements of each state; None: those of the median trajectory.
            cost: ``"trajectory"`` (each the same), ``"duration"`` or ``"samples"``; then shorter ones are tried, too.
            count: how many are suggested.
            rivals: another system to tell apart, or several, as right-hand sides by state; its constants are fitted.
            seed: of the experiments that are tried.
            data: as of `identifiability`.

        Raises:
            UsageError: a name or number does not fit, or the result does not have the measurements.
            DataError: the data cannot be used as they are.
        """
        found: Suggestions = _experiments().suggestions(
            self._result,
            data,
            bounds=bounds or {},
            duration=duration,
            samples=samples,
            cost=cost,
            count=count,
            seed=seed,
            rivals=[rivals] if isinstance(rivals, Mapping) else [*rivals],
        )
        return found

    @property
    def provenance(self) -> dict[str, Any]:
        """Where the model comes from: digests of data and result, job, seed, settings, command, versions."""
        its = self._result
        data = its.get("data") or {}
        named = ("job", "seed", "preset", "config", "command", "versions", "digest")
        return {"data": data.get("digest"), "files": data.get("files"), "rows": data.get("rows")} | {
            name: its.get(name) for name in named
        }

    @cached_property
    def candidates(self) -> tuple["Model", ...]:
        """The other equations that were compared, each as a model with the rest of this one, the best first.

        Their constants have no errors; `equations[i].nats` is how much longer the description of the data is.
        """
        found = [
            (float(other["nats"]), place, other)
            for place, equation in enumerate(self._result["equations"])
            for other in equation.get("candidates") or ()
            if not other["selected"] and other["nats"] is not None
        ]
        return tuple(Model(self._with(place, other)) for _, place, other in sorted(found, key=lambda each: each[0]))

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of trajectories that differ in constants; none where there is one set of them."""
        return differing_groups(self._result)

    def of_group(self, group: object) -> "Model":
        """Return the model with the constants of one of the `groups`; raises UsageError for another one."""
        name = str(group)
        if name not in self.groups:
            one = "the model has no groups, but one set of constants for all trajectories"
            there = f"the groups are {', '.join(self.groups)}" if self.groups else one
            raise UsageError(f"there is no group {name!r}; {there}")
        its = next(each for each in self._result["groups"] if each["group"] == name)
        return Model(of_group(self._result, its))

    def require_one_group(self) -> None:
        """Raise UsageError where constants differ between groups."""
        if self.groups:
            listed = ", ".join(self.groups)
            raise UsageError(
                f"constants of this model may differ between its groups ({listed})",
                python="choose one with of_group",
                command="choose one with --group",
            )

    def _with(self, place: int, other: Mapping[str, Any]) -> dict[str, Any]:
        """Return the result with another candidate in the place of an equation, without what belongs to the model."""
        unknown: dict[str, Any] = {
            "program": None,
            "constants": [],
            "implied": [],
            "candidates": [],
            "prediction": None,
            "bounds": [],
            "units": None,
        }
        unknown |= {"verdict": None, "reason": None}
        taken = {name: other[name] for name in ("expression", "complexity", "origin", "nats")}
        is_of_group = self._result.get("group") is not None
        equations = [
            {
                **each,
                **(unknown | taken if index == place else {}),
                "groups": [],
                "is_of_all_groups": bool(each.get("groups")) or (index == place and is_of_group),
            }
            for index, each in enumerate(self._result["equations"])
        ]
        return {
            **self._result,
            "equations": equations,
            "covariance": None,
            "groups": [],
            "correlations": [],
            "shared_terms": [],
            "chaos": None,
        }

    # ------------------------------------------------------------------------------------------- what it does

    @overload
    def simulate(
        self,
        x0: Given | None = None,
        t: npt.ArrayLike | float | None = None,
        u: Mapping[str, Any] | npt.ArrayLike | Callable[[float], Any] | None = None,
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
        u: Mapping[str, Any] | npt.ArrayLike | Callable[[float], Any] | None = None,
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
        u: Mapping[str, Any] | npt.ArrayLike | Callable[[float], Any] | None = None,
        *,
        has_bands: bool = True,
        group: object = None,
        paths: int | None = None,
        seed: int = 0,
    ) -> Simulation | Ensemble:
        """Integrate from an initial state. How it ends is its `status`: a blow-up is a result, not an error.

        One that ends early has the times that were reached alone; an `EarlyEndWarning` says so.

        Args:
            x0: the initial state, by name or in order; None: that of the first measured trajectory, with its inputs
                where `u` names none.
            t: times that ascend, the first being that of `x0`; one number: until then, from the first time measured;
                None: the times of the first trajectory.
            u: inputs: by name numbers, arrays at the times `t` or functions of time; or an array (N, U), or a function
                of time that returns U numbers. An input that is the time itself needs none.
            has_bands: whether the errors of the constants are carried on into 95 % bands, where they are known.
            group: of trajectories whose constants are taken, where these may differ; one of `groups`.
            paths: of a stochastic process, how many are drawn: an `Ensemble`. None: the drift alone is followed.
            seed: of the paths; the same seed gives the same paths.

        Raises:
            UsageError: the arguments do not fit, the model has no time, or its constants are those of groups and none
                is named; paths are asked for of a model without noise of its own.
        """
        if group is not None:
            model = self.of_group(group)
        else:
            self.require_one_group()
            model = self
        if paths is not None:
            require_process(model)
        field, times, start = model.field, model.times_of(t), model.start_of(x0)
        inputs = model.inputs_along(u, times, x0)
        if paths is not None:
            return ensemble_of(model, start, times, inputs, (paths, seed))
        bands = (model._errors, model._quantile) if has_bands and model._errors is not None else None
        found = replace(simulate(field, start, times, inputs, bands), time=model.time)
        if len(found.t) < len(times):
            warnings.warn(found.message, EarlyEndWarning, stacklevel=2)
        return found

    def stationary_density(
        self,
        x0: Given | None = None,
        *,
        inputs: Mapping[str, float] | None = None,
        paths: int = PATHS,
        seed: int = 0,
    ) -> StationaryDensity | None:
        """Return the density that paths of a stochastic process settle into; None where they do not settle.

        Paths that stay where they begin for longer than they are simulated settle there, as in one of two wells.

        Args:
            x0: where all paths begin; None: as measured.
            inputs: values at which inputs are held, by name; zeros unless given.
            paths: how many are drawn, at least 2.
            seed: of the paths.

        Raises:
            UsageError: the arguments do not fit, or the model has no noise of its own.
        """
        require_process(self)
        given = {name: number(its, f"the input {name!r}") for name, its in by_name(inputs, "inputs").items()}
        self.require_inputs(given)
        held = {self._result["symbols"].get(name, name): its for name, its in given.items()}
        return density_of_process(self, self.start_of(x0), [held.get(name, 0.0) for name in self.inputs], (paths, seed))

    @cached_property
    def components(self) -> dict[str, Pair]:
        """The equations of the diffusion g g' of a process dx = f dt + g dW: the places of both states, by name."""
        columns = [*enumerate(self._columns[name] for name in self.states)]
        pairs = {f"[{name}]": (place, place) for place, name in columns}
        pairs |= {f"[{one},{other}]": (i, j) for i, one in columns for j, other in columns if i < j}
        named = [each["variable"] for each in self._result["equations"]]
        return {name: pairs[name] for name in named if name in pairs}

    def predict(
        self, x: Mapping[str, Any] | npt.ArrayLike, u: Mapping[str, Any] | npt.ArrayLike | None = None
    ) -> FloatArray:
        """Return the derivatives at rows of states, of a regression its target.

        Args:
            x: (N, D) states, or columns by name (also a frame of pandas or polars); of a regression (N, U) inputs.
            u: (N, U) inputs; None where there are none, or where `x` has them by name.

        Returns:
            (N, D) derivatives, (N,) values of a regression; NaN where there is none.
        """
        self.require_one_group()
        if self.is_regression:
            program = from_infix(self._result["equations"][0]["expression"], self._names)
            values = values_of(program, np.ascontiguousarray(self._rows(x, self._names).T))
            return np.asarray(np.where(np.isfinite(values), values, np.nan))
        points = self._rows(x, self.states)
        if not self.inputs:
            return self.field.values(points)
        given = u if u is not None else (x if _has_columns(x) else None)
        if given is None:
            raise UsageError(f"the model has the inputs {', '.join(self.inputs)}; give their values as u")
        held = self._rows(given, self.inputs)
        if len(held) != len(points):
            raise UsageError(f"there are {len(held)} rows of inputs for {len(points)} of states; give one for each")
        return self.field.values(points, held)

    def analyse(
        self,
        box: Mapping[str, tuple[float, float]] | None = None,
        *,
        inputs: Mapping[str, float] | None = None,
        vary: tuple[str, tuple[float, float]] | None = None,
    ) -> "Analysis":
        """Return fixed points, limit cycles, basins and the rest of the dynamics, beside those of the data.

        Args:
            box: bounds of states, by name; None: about the measured range.
            inputs: values at which inputs are held, by name; zeros unless given.
            vary: what to vary, and the range over which fixed points and limit cycles are followed: a constant (c1),
                several in their ratio (c1,c2), the coefficient of a term (y:x*y, of x*y in dy/dt), or an input.

        Raises:
            UsageError: a name is unknown, a range is none, or a state has neither bounds nor measurements.
        """
        from atoll.analysis.analysis import analyse_result

        self.require_one_group()
        bounds = {name: interval(its, f"the bounds of {name!r}") for name, its in by_name(box, "the box").items()}
        held = {name: number(its, f"the input {name!r}") for name, its in by_name(inputs, "inputs").items()}
        if vary is not None and not (isinstance(vary, tuple) and len(vary) == 2 and isinstance(vary[0], str)):
            raise UsageError(
                f"vary must be a name and a range, such as ('c1', (0.0, 1.0)), but {shown(vary)} was given"
            )
        varied = None if vary is None else (vary[0], interval(vary[1], f"the range of {vary[0]!r}"))
        return analyse_result(self._result, bounds, inputs=held, vary=varied)

    def score(self, data: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> float:
        """Return R2 on data: columns by name (also a frame), or a list of these, one for each trajectory.

        A model of dynamics is simulated from the first row of each trajectory, and R2 is the mean over its measured
        states; minus infinity where a simulation does not reach the end. A regression is judged by its target.
        """
        self.require_one_group()
        parts: list[Any] = [*data] if isinstance(data, (list, tuple)) else [data]
        if not parts or not all(map(_has_columns, parts)):
            raise UsageError(f"a score takes columns by name, a frame or a list of these, but {shown(data)} was given")
        if self.is_regression:
            target = self._result["equations"][0]["variable"]
            both = [_stacked([_column(part, target), self.predict(part)]) for part in parts]
            return _r2(*np.concatenate(both, axis=1))
        found, measured_parts = [], []
        states = [name for name in self.states if all(_has(part, self._columns[name]) for part in parts)]
        if not states:
            columns = ", ".join(self._columns[name] for name in self.states)
            raise UsageError(f"the data have none of the columns {columns} in every part; give a measured state")
        for part in parts:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", EarlyEndWarning)
                its = self._simulated(part)
            if its.status != "finished":
                return -np.inf
            found.append(_stacked([its[name] for name in states]))
            measured_parts.append(_stacked([_column(part, self._columns[name]) for name in states]))
        pairs = zip(np.concatenate(measured_parts, axis=1), np.concatenate(found, axis=1), strict=True)
        return float(np.mean([_r2(measured, values) for measured, values in pairs]))

    def _simulated(self, part: Mapping[str, Any]) -> Simulation:
        """Return the simulation of measured rows from the first of them."""
        times, _, start = self.rows_of(part)
        inputs = {name: _column(part, self._columns[name]) for name in self.inputs}
        return self.simulate(start, times, inputs or None, has_bands=False)

    def rows_of(self, part: Mapping[str, Any]) -> tuple[FloatArray, dict[str, FloatArray], dict[str, float]]:
        """Return the times (N,) of measured rows, the measured states (N,) by name, and the state of the first row.

        Velocities of equations of second order that were not measured are those of the first rows.

        Raises:
            UsageError: a column is missing, or a state of the first row is.
        """
        times, positions, start = _column(part, self.time), self._positions, {}
        measured = [name for name in self.states if name not in positions or _has(part, self._columns[name])]
        values = {name: _column(part, self._columns[name]) for name in measured}
        _stacked([times, *values.values()])
        for name in self.states:
            if name in values:
                start[name] = float(values[name][0]) if len(times) else np.nan
            else:
                start[name] = _slope(times, _column(part, self._columns[positions[name]]), positions[name])
        unknown = next((name for name, value in start.items() if not np.isfinite(value)), None)
        if unknown is not None:
            raise UsageError(f"the first row has no finite {unknown!r}; begin with a row that has every state")
        return times, values, start

    @property
    def _positions(self) -> dict[str, str]:
        """The position of each velocity of equations of second order, by name; empty for other models."""
        half = len(self.states) // 2
        is_second = all(each["lhs"].startswith(f"d2{each['variable']}/") for each in self._result["equations"])
        return dict(zip(self.states[half:], self.states[:half], strict=True)) if is_second else {}

    def require_inputs(self, names: Iterable[str]) -> None:
        """Raise UsageError where one of `names`, symbols or columns, is no input."""
        unknown = next((name for name in names if self._result["symbols"].get(name, name) not in self.inputs), None)
        if unknown is not None:
            hint = did_you_mean(str(unknown), self.inputs)
            raise UsageError(f"there is no input {unknown!r}; the inputs are {', '.join(self.inputs) or 'none'}{hint}")

    def inputs_of(self, part: Mapping[str, Any]) -> dict[str, FloatArray]:
        """Return those inputs (N,) of measured rows that have a column, by name."""
        return {name: _column(part, self._columns[name]) for name in self.inputs if _has(part, self._columns[name])}

    # ------------------------------------------------------------------------------------------- what it looks like

    def __repr__(self) -> str:
        return "\n".join([*map(str, self.equations), *filter(None, [self.remark])])

    @property
    def remark(self) -> str:
        """What is to be said beside the equations: that constants are means over groups; "" where they are not."""
        return remark_on_groups(self._result)

    def summary(self) -> str:
        """Return equations, verdicts, constants and provenance as text."""
        from atoll.model.display import summary

        return summary(self)

    def to_sympy(self) -> "dict[str, sympy.Expr]":
        """Return the right-hand sides as sympy expressions, by left-hand side; constants keep every bit.

        Constants that differ between `groups` are means over them; see `of_group`.
        """
        from atoll_core.expression.text.export import to_sympy

        return {each.lhs: to_sympy(from_infix(each.exact, self._names), self._names) for each in self.equations}

    def latex(self) -> str:
        """Return the equations as lines of LaTeX's ``aligned`` environment.

        Constants that differ between `groups` are means over them; see `of_group`.
        """
        from atoll.model.display import latex

        return latex(self)

    def mathml(self) -> str:
        """Return the equations as MathML (presentation), one line of a table for each."""
        from atoll.model.display import mathml

        return mathml(self)

    def report(self, path: str | Path | None = None) -> str:
        """Return the result as one HTML page that needs neither network nor script, and write it to `path` if given.

        The model is analysed for it, which takes a second or two for two states.

        Raises:
            UsageError: the file cannot be written.
        """
        from atoll.report.page import as_html

        text = as_html(self._result)
        if path is not None:
            write_text(path, text)
        return text

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"

    def _repr_html_(self) -> str:
        from atoll.model.display import html

        return html(self)

    def plot_fit(self, axes: Any = None) -> Any:
        """Plot measurements and simulations with bands over time; see `atoll.model.plots.plot_fit`."""
        from atoll.model.plots import plot_fit

        return plot_fit(self, axes)

    def plot_residuals(self, axes: Any = None) -> Any:
        """Plot what simulations leave of the measurements; see `atoll.model.plots.plot_residuals`."""
        from atoll.model.plots import plot_residuals

        return plot_residuals(self, axes)

    def plot_phase(self, axes: Any = None) -> Any:
        """Plot the phase plane of two states; see `atoll.model.plots.plot_phase`."""
        from atoll.model.plots import plot_phase

        return plot_phase(self, axes)

    def plot_front(self, axes: Any = None) -> Any:
        """Plot error over complexity; see `atoll.model.plots.plot_front`."""
        from atoll.model.plots import plot_front

        return plot_front(self, axes)

    # ------------------------------------------------------------------------------------------- inside

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(self._result["symbols"].values())

    @cached_property
    def _columns(self) -> dict[str, str]:
        """Column names by symbol."""
        return {symbol: column for column, symbol in self._result["symbols"].items()}

    @cached_property
    def _errors(self) -> JointErrors | None:
        return JointErrors.of(self._result, self.field)

    @property
    def _freedom(self) -> float | None:
        its = self._result.get("covariance") or next(
            (each["covariance"] for each in self._result.get("groups") or ()), None
        )
        return (its or {}).get("freedom")

    @cached_property
    def _quantile(self) -> float:
        """Standard errors on either side of a 95 % band."""
        from scipy import special

        return float(special.stdtrit(self._freedom, 0.5 + LEVEL / 2.0) if self._freedom else special.ndtri(0.975))

    @property
    def first(self) -> Mapping[str, Any]:
        """The first simulated trajectory of the result; empty where there is none."""
        parts = (self._result.get("simulation") or {}).get("trajectories") or ()
        return next((each for each in parts if each.get("start")), {})

    @property
    def beginning(self) -> Mapping[str, Any]:
        """The first simulated trajectory, the ensemble of a process, else the first measured one; empty without."""
        return self.first or self._first_of_ensemble or self._first_measured

    @property
    def _first_of_ensemble(self) -> Mapping[str, Any]:
        """Name, start and times of the ensemble of a process; empty where there is none."""
        its = (self._result.get("process") or {}).get("ensemble")
        if not its:
            return {}
        start = {name: float(values[0]) for name, values in its["mean"].items()}
        return {"name": its.get("trajectory"), "start": start, "times": its["times"]}

    @property
    def _first_measured(self) -> Mapping[str, Any]:
        """Name, start and times of the first measured trajectory that has a row with all its states, from there on."""
        listed = (self._result.get("data") or {}).get("trajectories") or ()
        return next(filter(None, map(self.measured_beginning, listed)), {})

    def measured_beginning(self, part: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return name, start and times of the whole rows of a measured trajectory of the result; empty without any."""
        columns = {name: np.array(values, dtype=np.float64) for name, values in part["measured"].items()}
        times = np.array(part["times"], dtype=np.float64)
        known = np.flatnonzero(np.isfinite([times, *columns.values()]).all(axis=0))
        if not len(known):
            return {}
        rows = {name: values[known] for name, values in {self.time: times, **columns}.items()}
        start = {self._columns[name]: value for name, value in self.rows_of(rows)[2].items()}
        return {"name": part["name"], "start": start, "times": rows[self.time].tolist()}

    @property
    def recorded(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Times (N,) and values (N,) of the inputs that were recorded along the first trajectory, by symbol."""
        listed = (self._result.get("data") or {}).get("trajectories") or ()
        its = next((each for each in listed if each["name"] == self.beginning.get("name")), None)
        if its is None:
            return {}
        named, times = self._result["symbols"], np.array(its["times"], dtype=np.float64)
        columns = {named.get(name, name): np.array(each, dtype=np.float64) for name, each in its["inputs"].items()}
        known = {name: np.isfinite(values) for name, values in columns.items()}
        return {
            name: (times[known[name]], values[known[name]]) for name, values in columns.items() if known[name].any()
        }

    def start_of(self, x0: Given | None) -> FloatArray:
        if x0 is None:
            its = self.beginning
            if not its:
                example = self.states[0]
                raise UsageError(
                    "the result has no fitted initial state",
                    python=f"give one, such as x0={{{example!r}: 1.0}}",
                    command=f"give one, such as --initial {example}=1",
                )
            given: Given = {self._result["symbols"][name]: value for name, value in its["start"].items()}
        else:
            given = x0
        if not isinstance(given, Mapping):
            values = numbers(given, "an initial state")
            if values.shape != (len(self.states),):
                raise UsageError(f"an initial state has one number for each of {', '.join(self.states)}")
            return values
        symbols = self._result["symbols"]
        named = {symbols.get(name, name): value for name, value in given.items()}
        unknown = next((name for name in named if name not in self.states), None)
        missing = next((name for name in self.states if name not in named), None)
        if unknown is not None or missing is not None:
            fault = f"names {unknown!r}" if unknown is not None else f"lacks {missing!r}"
            hint = "" if unknown is None else did_you_mean(unknown, self.states)
            raise UsageError(f"the initial state {fault}; the states are {', '.join(self.states)}{hint}")
        return np.array([number(named[name], f"the initial value of {name!r}") for name in self.states])

    def times_of(self, t: npt.ArrayLike | float | None) -> FloatArray:
        first = np.array(self.beginning.get("times") or (), dtype=np.float64)
        if t is None:
            if not len(first):
                raise UsageError(
                    "the result has no simulated trajectory",
                    python="give the times, such as t=10.0",
                    command="give the last time, such as --until 10",
                )
            return first
        times = numbers(t, "times")
        if times.ndim:
            return times
        begin = float(first[0]) if len(first) else 0.0
        if not float(times) > begin:
            raise UsageError(f"a simulation begins at {self.time} = {begin:g} and ends later, but {t!r} was given")
        return np.linspace(begin, float(times), ROWS)

    def inputs_along(
        self,
        u: Mapping[str, Any] | npt.ArrayLike | Callable[[float], Any] | None,
        times: FloatArray,
        x0: Given | None,
    ) -> Inputs | None:
        recorded = self.recorded if x0 is None else {}
        if isinstance(u, Mapping):
            self.require_inputs(u)
        if not self.inputs:
            return None
        if callable(u):
            return lambda t: np.atleast_1d(numbers(u(t), "what u returns"))
        if u is not None and not isinstance(u, Mapping) and not _has_columns(u):
            values = numbers(u, "inputs")
            values = values.reshape(len(times), -1) if values.ndim and len(values) == len(times) else values
            if values.shape != (len(times), len(self.inputs)):
                shape = f"({len(times)}, {len(self.inputs)})"
                raise UsageError(f"inputs have the shape {values.shape}, expected {shape}: rows by {self.inputs}")
            return interpolated(times, values)
        given: Any = {} if u is None else u
        return together([self._input(name, given, times, recorded.get(name)) for name in self.inputs])

    def _input(
        self, name: str, given: Any, times: FloatArray, recorded: tuple[FloatArray, FloatArray] | None
    ) -> Callable[[float], float]:
        column = next((each for each in (name, self._columns[name]) if _has(given, each)), None)
        if column is None:
            if self._columns[name] == self.time:
                return lambda t: t
            if recorded is not None:
                return _curve(*recorded)
            raise UsageError(
                f"the model has the input {name!r}, of which nothing is given",
                python="name it in u",
                command=f"give a number, such as --hold {name}=1, or a file with its column as --initial",
            )
        its = given[column]
        if callable(its):
            return lambda t: number(its(t), f"what the function of the input {name!r} returns")
        values = numbers(its, f"the input {name!r}")
        if values.ndim == 0:
            return lambda _: float(values)
        if values.shape != times.shape:
            raise UsageError(f"the input {name!r} has {values.size} values for {len(times)} times; give one for each")
        return _curve(times, values)

    def _rows(self, given: Any, names: Sequence[str]) -> FloatArray:
        """Return rows (N, len(names)) from an array or from columns by name."""
        if _has_columns(given):
            return _stacked([_column(given, self._columns.get(name, name), name) for name in names]).T
        rows = numbers(given, f"rows of {', '.join(names)}")
        rows = rows[:, np.newaxis] if rows.ndim == 1 and len(names) == 1 else np.atleast_2d(rows)
        if rows.ndim != 2 or rows.shape[1] != len(names):
            raise UsageError(f"rows of {len(names)} numbers ({', '.join(names)}) are expected, found {rows.shape}")
        return rows


def _experiments() -> Any:
    """Return the module of what needs fits; loaded when it is first asked for."""
    from atoll.api import experiments

    return experiments


def _unit(variable: str, lhs: str, units: Mapping[str, str], time: str | None) -> str:
    """Return the unit of a left-hand side, of a regression without `time`; "" where a column has none."""
    above = units.get(variable, "")
    if time is None or "/" not in lhs:
        return above
    below = units.get(time, "")
    if not above or not below:
        return ""
    above, below = (f"({each})" if _COMPOUND.search(each) else each for each in (above, below))
    return f"{above}/{below}^2" if lhs.startswith("d2") else f"{above}/{below}"


def _has_columns(given: Any) -> bool:
    return isinstance(given, Mapping) or hasattr(given, "columns")


def _has(given: Any, name: str) -> bool:
    return name in (given.columns if hasattr(given, "columns") else given) or _is_index(given, name)


def _is_index(given: Any, name: str) -> bool:
    """Tell whether a name is that of the index of a pandas frame."""
    index = getattr(given, "index", None)
    return index is not None and not callable(index) and getattr(index, "name", None) == name


def _column(given: Any, *names: str) -> FloatArray:
    name = next((each for each in names if _has(given, each)), None)
    if name is None:
        raise UsageError(f"the data have no column {names[0]!r}; give one, by that name")
    return numbers(given.index if _is_index(given, name) else given[name], f"column {name!r}")


def _stacked(columns: Sequence[FloatArray]) -> FloatArray:
    """Return columns (N,) as one array (K, N); raises UsageError where their lengths differ."""
    shapes = {each.shape for each in columns}
    if len(shapes) > 1 or any(each.ndim != 1 for each in columns):
        lengths = ", ".join(sorted(str(each.shape[0] if each.ndim == 1 else each.shape) for each in columns))
        raise UsageError(f"columns have {lengths} rows; one number of rows is expected")
    return np.stack(columns)


def _curve(times: FloatArray, values: FloatArray) -> Callable[[float], float]:
    """Return `values` (N,) at `times` (N,) as a function of time."""
    curve = interpolated(times, values[:, np.newaxis])
    return lambda t: float(curve(t)[0])


def _slope(times: FloatArray, position: FloatArray, name: str) -> float:
    """Return the slope of a position (N,) at the first row, NaN where it is not known there; raises UsageError."""
    _stacked([times, position])
    if len(times) < 3:
        raise UsageError(f"a velocity is estimated from 3 rows of {name!r} or more, but the data have {len(times)}")
    return float(np.gradient(position, times, edge_order=2)[0])


def _r2(measured: FloatArray, values: FloatArray) -> float:
    known = np.isfinite(measured)
    left = float(((measured - values)[known] ** 2).sum())
    spread = float(((measured[known] - measured[known].mean()) ** 2).sum())
    return 1.0 - left / spread if spread > 0.0 else (1.0 if left == 0.0 else -np.inf)
