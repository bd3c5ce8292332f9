"""`atoll.Model`: a `ModelCore` with methods that simulate, predict, score, analyse, plan experiments, plot and export.

Each method imports the package that does its work when it is called, so that loading a model stays quick. Letters in
shapes: D states, U inputs, N rows or times.
"""

import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
import numpy.typing as npt

from atoll.api.tables import python_words, table_of
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
    stack_columns,
    start_of,
    times_of,
)
from atoll.model.core import ModelCore
from atoll.model.equations import (
    LEVEL,
    measured_ranges,
    outside_sentence,
    quantile,
    with_printed_rounding,
)
from atoll.model.simulation import (
    EarlyEndWarning,
    ExtrapolationWarning,
    Inputs,
    SimulationResult,
    SimulationWarning,
    density_of_process,
    ensemble_of,
    process_of,
    simulate,
)
from atoll_coordinator.process_steps.paths import PATHS, Ensemble, StationaryDensity
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import FrameLibrary, frame_of
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from atoll_core.quoting import path_of, shown, write_text

if TYPE_CHECKING:
    import polars
    import sympy

    from atoll.analysis.analysis import Analysis
    from atoll.experiments.comparison import Comparison
    from atoll.experiments.designs import Cost
    from atoll.experiments.forecast import Forecast
    from atoll.experiments.identifiability import Identifiability, ProfiledConstant
    from atoll.experiments.smoothing import SmoothedStates
    from atoll.experiments.suggestion import Suggestions
    from atoll.export.description import HeldInputs, Times
    from atoll_coordinator.model.batches import Spread


class Model(ModelCore):
    """The result of a job that has found all equations, with methods to use it.

    The exports (`to_python` and others) take the same initial state `x0`, times `t` and inputs `u` as `simulate`, and
    write them into the file. If `x0` is None, they use the recorded inputs. Inputs without a value are held at 0;
    functions of time are refused. Each export raises UsageError if the format cannot express the model, or if the
    initial state or the times are unknown. docs/export.md lists the programs that open each format.
    """

    @overload
    def simulate(
        self,
        x0: Given | None = None,
        t: npt.ArrayLike | float | None = None,
        u: GivenInputs = None,
        *,
        parameters: Mapping[str, float] | None = None,
        has_bands: bool = True,
        group: object = None,
        paths: None = None,
        seed: int = 0,
    ) -> SimulationResult: ...

    @overload
    def simulate(
        self,
        x0: Given | None = None,
        t: npt.ArrayLike | float | None = None,
        u: GivenInputs = None,
        *,
        parameters: Mapping[str, float] | None = None,
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
        parameters: Mapping[str, float] | None = None,
        has_bands: bool = True,
        group: object = None,
        paths: int | None = None,
        seed: int = 0,
    ) -> SimulationResult | Ensemble:
        """Integrate from an initial state. The `status` of the simulation says how it ended: a blow-up is not an error.

        A simulation that ends early has only the times that were reached, and gives an `EarlyEndWarning`. If `x0` is
        outside of the measured range, an `ExtrapolationWarning` is given.

        Args:
            x0: the initial state, by name or in order, angles in radians. None: the initial state of the first measured
                trajectory; its inputs are used unless `u` is given. Hidden states have given or fitted initial values,
                and parameters that differ by run the values of this trajectory. In `x0`, name both like states.
            t: ascending times; `x0` is the state at the first time. A number is the last time; the simulation then
                begins at the first measured time. None: the times of the first trajectory.
            u: inputs by name: numbers, arrays (N,) at the times `t`, or functions of time; or an array (N, U), or a
                function of time that returns U numbers. Leave out an input that is the time itself.
            parameters: other values of constants, by their names in `params`; the simulation then has no bands.
            has_bands: whether standard errors of the constants, if known, are propagated to 95 % bands.
            group: the group of trajectories whose constants are used, one of `groups`; required if constants differ.
            paths: for a stochastic process, the number of paths to draw; returns an `Ensemble`. None: integrate only
                the drift.
            seed: random seed of the paths; the same seed gives the same paths.

        Raises:
            UsageError: an argument does not fit the model; the model is a regression without time; constants differ
                between groups and `group` is None; or paths are requested for a model without noise.
        """
        model = self if group is None else self.of_group(group)
        model.require_one_group()
        if paths is not None:
            process_of(model)
            if parameters:
                raise UsageError("paths are drawn with the constants of the model; leave out parameters")
        values = {name: number(value, f"the parameter {name}") for name, value in (parameters or {}).items()}
        by_run = {name: values.pop(name) for name in model.result.by_run if name in values}
        if isinstance(x0, Mapping):
            x0 = {**x0, **by_run}
        field, observed, times, start = model.field, model.observed, times_of(model, t), start_of(model, x0)
        inputs = inputs_along(model, u, times, recorded_inputs(model) if x0 is None else {})
        remark = "" if x0 is None else _outside_range(model, start, None if u is None else inputs, float(times[0]))
        if remark:
            warnings.warn(remark, ExtrapolationWarning, stacklevel=2)
        if paths is not None:
            return ensemble_of(model, start, times, inputs, (paths, seed))
        if parameters:
            start = np.array([by_run.get(name, value) for name, value in zip(model.states, start, strict=True)])
            only_columns = {*observed.named_parameters} - {*field.named_parameters}
            field = field.with_values({name: value for name, value in values.items() if name not in only_columns})
            observed = observed.with_values(
                {name: value for name, value in values.items() if name in observed.named_parameters}
            )
        errors = model.joint_errors if has_bands and not parameters else None
        bands = None if errors is None else (errors, quantile(LEVEL, model.degrees_of_freedom))
        simulation = replace(
            simulate(field, start, times, inputs, bands, observed=observed), time=model.time, remark=remark
        )
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
        """Return the stationary density of the paths of a stochastic process; None if it does not converge.

        If all paths stay in one of several wells during the simulation, the density is only the density in that well.

        Args:
            x0: the initial state of all paths; None: the measured initial state.
            inputs: held values of inputs, by name; 0 by default.
            paths: the number of paths, at least 2.
            seed: random seed of the paths.

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

    def predict(self, x: Columns | npt.ArrayLike, u: Columns | npt.ArrayLike | None = None) -> FloatArray:
        """Return the derivatives at rows of states, or the target of a regression.

        Args:
            x: states (N, D), or columns by name (also a frame of pandas or polars); for a regression, inputs (N, U).
                Columns are read as in the fit: angles are in degrees if the fit read them in degrees. Arrays have
                angles in radians.
            u: inputs (N, U); None if the model has no inputs, or if `x` holds them by name.

        Returns:
            Derivatives (N, D), or values of a regression (N,); NaN where undefined. If rows of a regression are outside
            of the measured range, an `ExtrapolationWarning` is given.
        """
        self.require_one_group()
        x = read_columns(self, x) if has_columns(x) else x
        u = read_columns(self, u) if has_columns(u) else u
        if self.is_regression:
            program = from_infix(self.equations[0].exact, self.result.names)
            rows = points_of(self, x, self.inputs)
            remark = _rows_outside_range(self, rows)
            if remark:
                warnings.warn(remark, ExtrapolationWarning, stacklevel=2)
            values = values_of(program, np.ascontiguousarray(rows.T))
            return np.asarray(np.where(np.isfinite(values), values, np.nan))
        points = points_of(self, x, self.states)
        if not self.inputs:
            return self.field.values(points)
        given = u if u is not None else (x if has_columns(x) else None)
        if given is None:
            raise UsageError(f"the model has the inputs {', '.join(self.inputs)}; give their values as u")
        held = points_of(self, given, self.inputs)
        if len(held) != len(points):
            raise UsageError(
                f"u has {len(held)} rows, but x has {len(points)}; give a row of inputs for each row of states"
            )
        return self.field.values(points, held)

    def score(self, data: Columns | Sequence[Columns]) -> float:
        """Return R2 on data: columns by name (also a frame), or a list of such columns, one item per trajectory.

        A model of dynamics is simulated from the first row of each trajectory; R2 is the mean over the measured states,
        and minus infinity if a simulation does not reach the end. For a regression it is the R2 of the target.
        """
        self.require_one_group()
        given: list[object] = [*data] if isinstance(data, (list, tuple)) else [data]
        parts = [read_columns(self, part) for part in given if has_columns(part)]
        if not given or len(parts) < len(given):
            raise UsageError(f"a score needs columns by name, a frame or a list of these, but {shown(data)} was given")
        if self.is_regression:
            target = self._result.equations[0].variable
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ExtrapolationWarning)
                both = [stack_columns([column(part, target), self.predict(part)]) for part in parts]
            return _r2(*np.concatenate(both, axis=1))
        columns = self._result.columns_by_symbol
        columns = columns | {name: name for name in self.observed_columns}
        states = [
            name for name in (*self.states, *self.observed_columns) if all(has(part, columns[name]) for part in parts)
        ]
        if not states:
            names = ", ".join(columns[name] for name in (*self.states, *self.observed_columns))
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
            simulated.append(stack_columns([simulation[name] for name in states]))
            measured.append(stack_columns([column(part, columns[name]) for name in states]))
        pairs = zip(np.concatenate(measured, axis=1), np.concatenate(simulated, axis=1), strict=True)
        return float(np.mean([_r2(rows, values) for rows, values in pairs]))

    def conf_int(
        self, level: float = LEVEL, method: Literal["stderr", "profile"] = "stderr"
    ) -> dict[str, tuple[float, float] | None]:
        """Return the confidence interval of each constant at `level`; None for an unknown interval.

        `method`: "stderr" computes intervals from standard errors, "profile" from the profile likelihood. An end of a
        profile interval is infinite if the data do not limit it.
        """
        if not 0.0 < number(level, "a level") < 1.0:
            raise UsageError(f"a level must be between 0 and 1, but {level!r} was given")
        if method not in ("stderr", "profile"):
            raise UsageError(f"the method of an interval is 'stderr' or 'profile', but {method!r} was given")
        if method == "profile":
            known = self.profile(level)
            return {name: known[name].interval if name in known else None for name in self.params}
        return {name: parameter.interval_at(level, self.degrees_of_freedom) for name, parameter in self.params.items()}

    def analyse(
        self,
        box: Mapping[str, tuple[float, float]] | None = None,
        *,
        inputs: Mapping[str, float] | None = None,
        vary: tuple[str, tuple[float, float]] | None = None,
        executor: object = None,
    ) -> "Analysis":
        """Return fixed points, limit cycles, basins of attraction and other dynamics, compared with the data.

        Args:
            box: bounds of states by name; None: the measured range, extended by half of its width on each side.
            inputs: held values of inputs, by name; 0 by default.
            vary: a parameter and its range, over which fixed points and limit cycles are followed. The parameter is a
                constant (c1), several constants in a fixed ratio (c1,c2), the coefficient of a term (y:x*y is the
                coefficient of x*y in dy/dt), or an input.
            executor: computes the parts that take longest, as for `identifiability`.

        Raises:
            UsageError: a name is unknown, a range is invalid, or a state has neither bounds nor measurements.
        """
        from atoll.analysis.analyse import analyse_model

        with _spread_over(executor) as spread:
            return analyse_model(self, box, inputs=inputs, vary=vary, spread=spread)

    def profile(
        self, level: float = LEVEL, data: object = None, *, executor: object = None
    ) -> "dict[str, ProfiledConstant]":
        """Return the profile likelihood of each constant, by name; see `identifiability`."""
        identified = self.identifiability(level, data, executor=executor)
        return {constant.name: constant for constant in identified.constants}

    def identifiability(
        self, level: float = LEVEL, data: object = None, *, executor: object = None
    ) -> "Identifiability":
        """Return how well the data determine each constant, and which constants are determined only jointly.

        Args:
            level: confidence level of the intervals, between 0 and 1.
            data: measurements to use instead of the measurements in the result, in a form that `atoll.discover`
                accepts.
            executor: computes the profiles, see `atoll.discover`; None: this process does. Results have the same bits
                if this process uses the same linear algebra as the workers (docs/reproducibility.md).

        Raises:
            UsageError: the measurements have no times, or the result has no measurements.
            DataError: the data cannot be used as they are.
        """
        from atoll.experiments.identifiability import identify

        self.require_one_group()
        with python_words(), _spread_over(executor) as spread:
            return identify(self.result, self._table(data), level, spread)

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
        data: object = None,
        executor: object = None,
    ) -> "Suggestions":
        """Return the experiments that give the most information per cost about which candidate is right.

        If all candidates predict the same, or there is only one candidate, the experiments give the most information
        about the constants of the displayed equations.

        Args:
            bounds: bounds of initial states and constant inputs, by name; None: the range of the data.
            duration: duration of an experiment; None: the duration of the median measured trajectory.
            samples: number of measurements of each state; None: as in the median measured trajectory.
            cost: ``"trajectory"`` (each costs 1), ``"duration"`` or ``"samples"``; the latter two also try shorter
                experiments.
            count: number of suggestions.
            rivals: alternative models to distinguish, as right-hand sides by state; their constants are fitted.
            seed: random seed of the trial experiments.
            data: as for `identifiability`.
            executor: computes the trials and the fits to their outcomes, as for `identifiability`.

        Raises:
            UsageError: a name or number does not fit, or the result has no measurements.
            DataError: the data cannot be used as they are.
        """
        from atoll.experiments.designs import DesignRequest
        from atoll.experiments.suggestion import suggest

        request = DesignRequest(
            bounds=bounds or {},
            duration=duration,
            samples=samples,
            cost=cost,
            count=count,
            seed=seed,
            rivals=[rivals] if isinstance(rivals, Mapping) else [*rivals],
        )
        with python_words(), _spread_over(executor) as spread:
            return suggest(self.result, request, self._table(data), spread)

    def smooth(self, data: object = None) -> "SmoothedStates":
        """Return the states along each trajectory under the law, with standard errors and 95 % bands.

        The constants are those of the model; the initial states of the trajectories are fitted. A trajectory that one
        initial state does not describe (chaos, or a missing effect) is divided into pieces; the result has the times at
        which they join.

        Args:
            data: trajectories to use instead of the measurements in the result, as for `identifiability`.

        Raises:
            UsageError: the model is a regression or a stochastic process, or there are no measurements.
            DataError: the data cannot be used as they are.
            AtollError: the law cannot be simulated along the data.
        """
        from atoll.experiments.smoothing import smooth

        self.require_one_group()
        with python_words():
            return smooth(self.result, self._table(data))

    def forecast(  # noqa: PLR0913, the keywords are the options of the command
        self,
        duration: float,
        u: GivenInputs = None,
        *,
        data: object = None,
        trajectory: str | None = None,
        step: float | None = None,
        draws: int = 1_000,
        seed: int = 0,
        has_rivals: bool = True,
    ) -> "Forecast":
        """Return the states after the last row of a trajectory: medians, 50 % and 95 % bands, and a horizon.

        The state at the last row is fitted to the last rows under the law. The draws have constants, states at the last
        row, and alternative systems by their odds. The `horizon` is the time until which the 95 % band is at most half
        as wide as the range of 95 % of the measured values. For a stochastic process, paths are drawn.

        Args:
            duration: length of the forecast after the last row, in units of time.
            u: inputs after the last row, as for `simulate`; arrays (N,) have their values at the times of the forecast,
                of which the first is the time of the last row. A missing input keeps its last value.
            data: trajectories to use instead of the measurements in the result, such as newer rows, as for
                `identifiability`. They change the state at the last row, and not the constants.
            trajectory: the name of the trajectory; None: the last one.
            step: time step; None: 200 steps.
            draws: number of draws.
            seed: random seed of the draws.
            has_rivals: whether alternative systems that fit about as well are drawn too.

        Raises:
            UsageError: an argument does not fit, the model is a regression, or there are no measurements.
            DataError: the data cannot be used as they are.
            AtollError: the law cannot be simulated along the last rows.
        """
        from atoll.experiments.forecast import ForecastRequest, forecast

        request = ForecastRequest(
            number(duration, "the duration of a forecast"), trajectory, step, draws, seed, has_rivals
        )
        with python_words():
            return forecast(self.result, request, self._table(data), u)

    def compare(self, other: "Model", data: object = None) -> "Comparison":
        """Compare this model, A, with another model, B, such as one of its `candidates`, on the same data.

        The comparison says which model is better, with which odds, and which equations have the same form.

        Args:
            other: a model with the same states or target.
            data: measurements for both models, as for `identifiability`; None: the measurements in the result.

        Raises:
            UsageError: the models have different states, or a result has no measurements.
            AtollError: a model cannot be simulated along the data.
        """
        from atoll.experiments.comparison import compare

        with python_words():
            return compare(self.result, other.result, table=self._table(data))

    def summary(self) -> str:
        """Return equations, verdicts, constants and provenance as text."""
        from atoll.display.notation import summary

        return summary(self)

    def to_sympy(self) -> "dict[str, sympy.Expr]":
        """Return the right-hand sides as sympy expressions, by left-hand side; constants are not rounded.

        Needs sympy (``pip install 'atoll[sympy]'``); raises UsageError without it.
        Constants that differ between `groups` are means over them; see `of_group`.
        """
        from atoll.display.notation import sympy_expressions

        return sympy_expressions(self)

    def latex(self) -> str:
        """Return the equations as lines of LaTeX's ``aligned`` environment.

        Constants that differ between `groups` are means over them; see `of_group`.
        """
        from atoll.display.notation import latex

        return latex(self)

    def mathml(self) -> str:
        """Return the equations as presentation MathML: a table with one row for each equation."""
        from atoll.display.notation import mathml

        return mathml(self)

    def report(self, path: str | Path = "report.html", *, executor: object = None) -> Path:
        """Write the result as one HTML page without scripts or external resources; return its path.

        An existing file is replaced. The analyses take a second or two for two states; an `executor` computes them as
        for `identifiability`.

        Raises:
            UsageError: the file cannot be written.
        """
        file = path_of(path)
        write_text(file, self.to_html(executor=executor))
        return file

    def to_html(self, *, executor: object = None) -> str:
        """Return the page that `report` writes."""
        from atoll.report.page import as_html

        with _spread_over(executor) as spread:
            return as_html(self.result, spread)

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return a row for each constant: `name`, `equation`, `value`, `stderr`, ends of the 95 % interval, `unit`.

        `library` is ``"polars"`` or ``"pandas"``. Unknown values are null. Raises UsageError if the library is not
        installed.
        """
        constants = self.params.values()
        intervals = [constant.interval or (None, None) for constant in constants]
        return frame_of(
            {
                "name": [constant.name for constant in constants],
                "equation": [constant.variable for constant in constants],
                "value": [constant.value for constant in constants],
                "stderr": [constant.stderr for constant in constants],
                "lower": [low for low, _ in intervals],
                "upper": [high for _, high in intervals],
                "unit": [constant.unit for constant in constants],
            },
            library,
        )

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"

    def _repr_html_(self) -> str:
        from atoll.display.notation import html

        return html(self)

    def plot_fit(self, axes: object = None) -> "npt.NDArray[np.object_]":
        """Plot measurements and simulations with their bands over time; see `atoll.display.plots.plot_fit`."""
        from atoll.display.plots import plot_fit

        return plot_fit(self, axes)

    def plot_forecast(self, forecast: "Forecast", axes: object = None) -> "npt.NDArray[np.object_]":
        """Plot a forecast with its bands after the measurements; see `atoll.display.plots.plot_forecast`."""
        from atoll.display.plots import plot_forecast

        measured = {forecast.time: forecast.measured_t, **forecast.measured}
        return plot_forecast(self, forecast.columns(), measured, axes)

    def plot_residuals(self, axes: object = None) -> "npt.NDArray[np.object_]":
        """Plot the residuals of simulations; see `atoll.display.plots.plot_residuals`."""
        from atoll.display.plots import plot_residuals

        return plot_residuals(self, axes)

    def plot_phase(self, axes: object = None) -> "npt.NDArray[np.object_]":
        """Plot the phase plane of two states; see `atoll.display.plots.plot_phase`."""
        from atoll.display.plots import plot_phase

        return plot_phase(self, axes)

    def plot_front(self, axes: object = None) -> "npt.NDArray[np.object_]":
        """Plot error over complexity; see `atoll.display.plots.plot_front`."""
        from atoll.display.plots import plot_front

        return plot_front(self, axes)

    def export(self, format: str, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return the model as the text of one file; `format` is the name of the format."""
        from atoll.export.formats import export_model

        return export_model(self, format, x0, t, u)

    def to_python(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return a Python module that needs only numpy and has its own integrator."""
        return self.export("python", x0, t, u)

    def to_c(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return a C99 program that integrates by itself and prints CSV."""
        return self.export("c", x0, t, u)

    def to_julia(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return a Julia script with a ModelingToolkit system."""
        return self.export("julia", x0, t, u)

    def to_matlab(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return a MATLAB function that calls ode45."""
        return self.export("matlab", x0, t, u)

    def to_modelica(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return a Modelica model."""
        return self.export("modelica", x0, t, u)

    def to_xppaut(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return an .ode file for XPPAUT."""
        return self.export("xppaut", x0, t, u)

    def to_sbml(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return SBML L3V2, validated if libsbml is installed (``pip install 'atoll[sbml]'``)."""
        return self.export("sbml", x0, t, u)

    def to_latex(self) -> str:
        """Return the equations as LaTeX, aligned."""
        return self.export("latex")

    def to_csv(self) -> str:
        """Return the fronts as CSV: for each variable the displayed equation, then the members of its front."""
        return self.export("csv")

    def to_json(self) -> str:
        """Return the content of result.json."""
        return self.export("json")

    def to_petab(self, folder: str | Path, data: "Sequence[Columns] | None" = None) -> None:
        """Write a PEtab problem: SBML, measurements, noise and bounds.

        Args:
            folder: the folder to write into, created if needed.
            data: measured columns by name (or a frame) for each trajectory; None: the measurements in the result.

        Raises:
            UsageError: the model is a regression or a process, there are no measurements, or the folder cannot be
                written.
        """
        from atoll.export.petab import export_petab

        export_petab(self, folder, data)

    def _table(self, data: object) -> Table | None:
        """Return the user's measurements, read with the data settings of the fit; None for None."""
        from atoll.model.core import config_of

        return None if data is None else table_of(data, config_of(self.result).data)


def _spread_over(executor: object) -> "AbstractContextManager[Spread | None]":
    """Return a context manager: a `Spread` over the executor of a user; None without an executor."""
    if executor is None:
        return nullcontext()
    from atoll.executors.batches import spread_over

    return spread_over(executor)


def _outside_range(model: Model, start: FloatArray, inputs: Inputs | None, time: float) -> str:
    """Return a sentence that names the states of `start` (D,) and inputs at `time` outside of the measured range, or
    "".
    """
    values = dict(zip(model.states, start.tolist(), strict=True))
    if inputs is not None:
        clock = model.result.symbols.get(model.time)
        driven = zip(model.inputs, np.asarray(inputs(time), dtype=np.float64).tolist(), strict=True)
        values |= {name: value for name, value in driven if name != clock}
    return outside_sentence(values, measured_ranges(model.result))


def _rows_outside_range(model: Model, rows: FloatArray) -> str:
    """Return a sentence about the `rows` (N, U) of inputs that are outside of the measured range, or ""."""
    ranges, outside, names = measured_ranges(model.result), np.zeros(len(rows), dtype=np.bool_), list[str]()
    for name, values in zip(model.inputs, rows.T, strict=True):
        low, high = ranges.get(name, (-np.inf, np.inf))
        least, largest = with_printed_rounding(low, high)
        is_outside = (values < least) | (values > largest)
        if is_outside.any():
            names.append(f"{name} (measured: {low:.4g} to {high:.4g})")
            outside |= is_outside
    if not names:
        return ""
    count = f"{np.count_nonzero(outside)} of {len(rows)} rows"
    return f"{count} are outside of the measured range of {', '.join(names)}; the model is extrapolated there"


def _r2(measured: FloatArray, values: FloatArray) -> float:
    known = np.isfinite(measured)
    residual = float(((measured - values)[known] ** 2).sum())
    spread = float(((measured[known] - measured[known].mean()) ** 2).sum())
    return 1.0 - residual / spread if spread > 0.0 else (1.0 if residual == 0.0 else -np.inf)
