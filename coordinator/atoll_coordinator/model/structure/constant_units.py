"""Units of the constants of an equation, derived from the units of the columns."""

from atoll_coordinator.dimensions import EquationUnits, rate_unit, units_of, units_of_columns
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset
from atoll_core.expression.program import Program

_VELOCITY = "_dot"


def equation_units(dataset: Dataset, config: JobConfig, variable: str, program: Program) -> EquationUnits | None:
    """Return the findings on the units of the equation of `variable`; None if no unit is known.

    Args:
        dataset: the dataset with the names of columns and left-hand sides.
        config: the resolved configuration with units by column; angles are in radians and have no unit.
        variable: the variable of the equation.
        program: the right-hand side of the equation.
    """
    known = units_of_columns(config.data.units, config.data.angles)
    if not known:
        return None
    lhs = dataset.problem(variable).target.lhs
    time = _time_of(lhs, config.data.order)
    units = {}
    for column, symbol in dataset.symbols.items():
        unit = known.get(column)
        if unit is None and config.data.order == 2 and _VELOCITY in column:
            unit = rate_unit(known.get(column.rpartition(_VELOCITY)[0]), known.get(time or ""), 1)
        if unit is not None:
            units[symbol] = unit
    left = known.get(variable)
    if time is not None:
        left = rate_unit(left, known.get(time), config.data.order)
    return units_of(program, dataset.names, units, left)


def _time_of(lhs: str, order: int) -> str | None:
    """Return the name of the time in a left-hand side such as ``dx/dt`` or ``d2x/dt2``. None if it has no time."""
    _, slash, time = lhs.rpartition("/d")
    if not slash:
        return None
    return time.removesuffix("2") if order == 2 else time
