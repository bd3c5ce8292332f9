"""What a model has to be written in the formats of other programs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from atoll.model.model import Model


class Exports:
    """Methods of a model that write it; docs/export.md says who opens what.

    `x0`, `t` and `u` are the initial state, the times and the inputs that a file holds, as `atoll.Model.simulate` takes
    them, with the inputs that were recorded where `x0` is None; inputs of which nothing is known are held at 0, and
    functions of time are refused. Each raises UsageError where the format cannot hold the model, or where nothing tells
    the initial state or the times.
    """

    def export(self, format: str, x0: Any = None, t: Any = None, u: Mapping[str, Any] | None = None) -> str:
        """Return the model in a format of one file, by its name."""
        from atoll.model.export.content import content_of
        from atoll.model.export.formats import format_of

        its, model = format_of(format), cast("Model", self)
        if its.of_content is not None:
            return its.of_content(content_of(model, x0, t, u, its.without_tables))
        assert its.of_result is not None
        return its.of_result(model.result)

    def to_python(self, x0: Any = None, t: Any = None, u: Mapping[str, Any] | None = None) -> str:
        """Return a Python module that needs numpy alone and integrates by itself."""
        return self.export("python", x0, t, u)

    def to_c(self, x0: Any = None, t: Any = None, u: Mapping[str, Any] | None = None) -> str:
        """Return a C99 program that integrates by itself and prints CSV."""
        return self.export("c", x0, t, u)

    def to_julia(self, x0: Any = None, t: Any = None, u: Mapping[str, Any] | None = None) -> str:
        """Return a Julia script with a system of ModelingToolkit."""
        return self.export("julia", x0, t, u)

    def to_matlab(self, x0: Any = None, t: Any = None, u: Mapping[str, Any] | None = None) -> str:
        """Return a MATLAB function that calls ode45."""
        return self.export("matlab", x0, t, u)

    def to_modelica(self, x0: Any = None, t: Any = None, u: Mapping[str, Any] | None = None) -> str:
        """Return a Modelica model."""
        return self.export("modelica", x0, t, u)

    def to_xppaut(self, x0: Any = None, t: Any = None, u: Mapping[str, Any] | None = None) -> str:
        """Return an .ode file of XPPAUT."""
        return self.export("xppaut", x0, t, u)

    def to_sbml(self, x0: Any = None, t: Any = None, u: Mapping[str, Any] | None = None) -> str:
        """Return SBML L3V2, checked by libsbml where it is installed (``pip install 'atoll[sbml]'``)."""
        return self.export("sbml", x0, t, u)

    def to_latex(self) -> str:
        """Return the equations as LaTeX, aligned."""
        return self.export("latex")

    def to_csv(self) -> str:
        """Return the fronts as CSV: for each equation the one that is shown, then its front."""
        return self.export("csv")

    def to_json(self) -> str:
        """Return the content of result.json."""
        return self.export("json")

    def to_petab(self, folder: str | Path, data: Sequence[Mapping[str, Any]] | None = None) -> None:
        """Write a PEtab problem: SBML, measurements, noise and bounds.

        Args:
            folder: where; it is made.
            data: measured columns by name (or a frame) for each trajectory; None: what the result holds.

        Raises:
            UsageError: the model has no time, is a process or has no measurements; the folder cannot be written.
        """
        from atoll.model.export import petab
        from atoll.model.export.content import content_of, inputs_beside_time

        model = cast("Model", self)
        start, times = (None, None) if data is None else petab.beginning(model, data)
        placeholders = dict.fromkeys(inputs_beside_time(model), 0.0)
        petab.save(petab.write(model, content_of(model, start, times, placeholders), data), folder)
