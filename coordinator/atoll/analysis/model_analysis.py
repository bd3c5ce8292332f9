"""The dynamics of a model, asked for in the words of Python users."""

from collections.abc import Mapping

from atoll.analysis.analysis import Analysis, analyse_result
from atoll.model.arguments import by_name, interval, number
from atoll.model.model import Model
from atoll_core.errors import UsageError
from atoll_core.quoting import shown


def analyse_model(
    model: Model,
    box: Mapping[str, tuple[float, float]] | None = None,
    *,
    inputs: Mapping[str, float] | None = None,
    vary: tuple[str, tuple[float, float]] | None = None,
) -> Analysis:
    """Return the dynamics of a model; see `atoll.Model.analyse`."""
    model.require_one_group()
    bounds = {name: interval(ends, f"the bounds of {name!r}") for name, ends in by_name(box, "the box").items()}
    held = {name: number(value, f"the input {name!r}") for name, value in by_name(inputs, "inputs").items()}
    if vary is not None and not (isinstance(vary, tuple) and len(vary) == 2 and isinstance(vary[0], str)):
        raise UsageError(f"vary must be a name and a range, such as ('c1', (0.0, 1.0)), but {shown(vary)} was given")
    parameter = None if vary is None else (vary[0], interval(vary[1], f"the range of {vary[0]!r}"))
    return analyse_result(model.result, bounds, inputs=held, vary=parameter)
