"""Methods of a model that analyse, plan, display and export it; each imports its package when it is called."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from atoll.model.equations import LEVEL
from atoll_core.data.frames import FrameLibrary, frame_of
from atoll_core.errors import UsageError
from atoll_core.quoting import path_of

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    import polars
    import sympy

    from atoll.analysis.analysis import Analysis
    from atoll.experiments.comparison import Comparison
    from atoll.experiments.designs import Cost
    from atoll.experiments.identifiability import Identifiability, ProfiledConstant
    from atoll.experiments.suggestion import Suggestions
    from atoll.export.description import HeldInputs, Times
    from atoll.model.arguments import Columns, Given
    from atoll.model.model import Model


def write_text(path: str | Path, text: str) -> None:
    """Write a file; raises UsageError."""
    try:
        path_of(path).write_text(text, "utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error.strerror}); name another file") from error


class Shortcuts:
    """Methods of a model that analyse, plan, display and export it.

    Exports take `x0`, `t` and `u`, the initial state, the times and the inputs of the file, as `Model.simulate` does,
    with the recorded inputs where `x0` is None. Unknown inputs are held at 0; functions of time are refused. Each
    raises UsageError where the format cannot hold the model, or where the initial state or the times are not known.
    docs/export.md lists the programs that open each format.
    """

    @property
    def itself(self) -> "Model":
        """The model whose methods these are."""
        return cast("Model", self)

    def analyse(
        self,
        box: Mapping[str, tuple[float, float]] | None = None,
        *,
        inputs: Mapping[str, float] | None = None,
        vary: tuple[str, tuple[float, float]] | None = None,
    ) -> "Analysis":
        """Return fixed points, limit cycles, basins and the rest of the dynamics, compared with the data.

        Args:
            box: bounds of states, by name; None: around the measured range.
            inputs: held values of inputs, by name; 0 by default.
            vary: a parameter and the range over which fixed points and limit cycles are followed: a constant (c1),
                several in their ratio (c1,c2), the coefficient of a term (y:x*y, of x*y in dy/dt), or an input.

        Raises:
            UsageError: a name is unknown, a range is invalid, or a state has neither bounds nor measurements.
        """
        from atoll.analysis.analysis import analyse_model

        return analyse_model(self.itself, box, inputs=inputs, vary=vary)

    def profile(self, level: float = LEVEL, data: object = None) -> "dict[str, ProfiledConstant]":
        """Return the profile likelihood of each constant, by name; see `identifiability`."""
        return {constant.name: constant for constant in self.identifiability(level, data).constants}

    def identifiability(self, level: float = LEVEL, data: object = None) -> "Identifiability":
        """Return how well the data determine each constant, and which constants only together.

        Args:
            level: of the intervals.
            data: as for `atoll.discover`, in place of the measurements in the result.

        Raises:
            UsageError: states were not measured in time, or the result has no measurements.
            DataError: the data cannot be used as they are.
        """
        from atoll.api.experiments import identifiability

        return identifiability(self.itself, data, level)

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
    ) -> "Suggestions":
        """Return the next experiments: the most information about the right candidate for their cost.

        If candidates do not differ, or there is only one, experiments are chosen that determine its constants best.

        Args:
            bounds: bounds of initial states and constant inputs, by name; None: the range of the data.
            duration: duration of an experiment; None: as the median measured trajectory.
            samples: measurements of each state; None: as the median measured trajectory.
            cost: ``"trajectory"`` (all the same), ``"duration"`` or ``"samples"``: then also for shorter ones.
            count: the number of suggestions.
            rivals: alternative models to distinguish, as right-hand sides by state; their constants are fitted.
            seed: random seed of the experiments that are tried.
            data: as for `identifiability`.

        Raises:
            UsageError: a name or number does not fit, or the result has no measurements.
            DataError: the data cannot be used as they are.
        """
        from atoll.api.experiments import suggestions
        from atoll.experiments.designs import DesignRequest

        request = DesignRequest(
            bounds=bounds or {},
            duration=duration,
            samples=samples,
            cost=cost,
            count=count,
            seed=seed,
            rivals=[rivals] if isinstance(rivals, Mapping) else [*rivals],
        )
        return suggestions(self.itself, data, request)

    def compare(self, other: "Model", data: object = None) -> "Comparison":
        """Compare this model, A, with another model, B, such as one of its `candidates`, on the same data.

        The result has the better model, its odds, and the equations that have the same form.

        Args:
            other: a model of the same states or target.
            data: as for `identifiability`, in place of the data of both.

        Raises:
            UsageError: the models have different states, or a result has no measurements.
            AtollError: one of them cannot be simulated along the data.
        """
        from atoll.api.experiments import comparison

        return comparison(self.itself, other, data)

    def summary(self) -> str:
        """Return equations, verdicts, constants and provenance as text."""
        from atoll.display.notation import summary

        return summary(self.itself)

    def to_sympy(self) -> "dict[str, sympy.Expr]":
        """Return the right-hand sides as sympy expressions, by left-hand side; constants keep every bit.

        Constants that differ between `groups` are means over them; see `of_group`.
        """
        from atoll.display.notation import sympy_expressions

        return sympy_expressions(self.itself)

    def latex(self) -> str:
        """Return the equations as lines of LaTeX's ``aligned`` environment.

        Constants that differ between `groups` are means over them; see `of_group`.
        """
        from atoll.display.notation import latex

        return latex(self.itself)

    def mathml(self) -> str:
        """Return the equations as MathML (presentation), one line of a table for each."""
        from atoll.display.notation import mathml

        return mathml(self.itself)

    def report(self, path: str | Path = "report.html") -> Path:
        """Write the result as one HTML page without scripts or external resources; return its path.

        An existing file is replaced. The analysis of the model takes a second or two for two states.

        Raises:
            UsageError: the file cannot be written.
        """
        file = path_of(path)
        write_text(file, self.to_html())
        return file

    def to_html(self) -> str:
        """Return the page that `report` writes."""
        from atoll.report.page import as_html

        return as_html(self.itself.result)

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return the constants, a row each: `name`, `equation`, `value`, `stderr`, ends of the 95 % interval, `unit`.

        As a frame of ``"polars"`` or ``"pandas"``; null where it is not known. Raises UsageError if it is missing.
        """
        constants = self.itself.params.values()
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

        return html(self.itself)

    def plot_fit(self, axes: object = None) -> "npt.NDArray[np.object_]":
        """Plot measurements and simulations with bands over time; see `atoll.display.plots.plot_fit`."""
        from atoll.display.plots import plot_fit

        return plot_fit(self.itself, axes)

    def plot_residuals(self, axes: object = None) -> "npt.NDArray[np.object_]":
        """Plot the residuals of simulations; see `atoll.display.plots.plot_residuals`."""
        from atoll.display.plots import plot_residuals

        return plot_residuals(self.itself, axes)

    def plot_phase(self, axes: object = None) -> "npt.NDArray[np.object_]":
        """Plot the phase plane of two states; see `atoll.display.plots.plot_phase`."""
        from atoll.display.plots import plot_phase

        return plot_phase(self.itself, axes)

    def plot_front(self, axes: object = None) -> "npt.NDArray[np.object_]":
        """Plot error over complexity; see `atoll.display.plots.plot_front`."""
        from atoll.display.plots import plot_front

        return plot_front(self.itself, axes)

    def export(self, format: str, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return the model in a format of one file, by its name."""
        from atoll.export.formats import written

        return written(self.itself, format, x0, t, u)

    def to_python(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return a Python module that needs only numpy and has its own integrator."""
        return self.export("python", x0, t, u)

    def to_c(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return a C99 program that integrates by itself and prints CSV."""
        return self.export("c", x0, t, u)

    def to_julia(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return a Julia script with a system of ModelingToolkit."""
        return self.export("julia", x0, t, u)

    def to_matlab(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return a MATLAB function that calls ode45."""
        return self.export("matlab", x0, t, u)

    def to_modelica(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return a Modelica model."""
        return self.export("modelica", x0, t, u)

    def to_xppaut(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return an .ode file of XPPAUT."""
        return self.export("xppaut", x0, t, u)

    def to_sbml(self, x0: "Given | None" = None, t: "Times" = None, u: "HeldInputs" = None) -> str:
        """Return SBML L3V2, checked by libsbml where it is installed (``pip install 'atoll[sbml]'``)."""
        return self.export("sbml", x0, t, u)

    def to_latex(self) -> str:
        """Return the equations as LaTeX, aligned."""
        return self.export("latex")

    def to_csv(self) -> str:
        """Return the fronts as CSV: for each equation the displayed one, then its front."""
        return self.export("csv")

    def to_json(self) -> str:
        """Return the content of result.json."""
        return self.export("json")

    def to_petab(self, folder: str | Path, data: "Sequence[Columns] | None" = None) -> None:
        """Write a PEtab problem: SBML, measurements, noise and bounds.

        Args:
            folder: it is created if needed.
            data: measured columns by name (or a frame) for each trajectory; None: the measurements in the result.

        Raises:
            UsageError: the model has no time, is a process or has no measurements; the folder cannot be written.
        """
        from atoll.export.petab import export_petab

        export_petab(self.itself, folder, data)
