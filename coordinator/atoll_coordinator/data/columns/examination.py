"""The checks of columns, in one table, made in order; what they found is acted on where that is safe. Pure."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_coordinator.data.columns.clipping import check_clipping
from atoll_coordinator.data.columns.counters import check_counters
from atoll_coordinator.data.columns.fill_values import check_fill_values, fill_values
from atoll_coordinator.data.columns.finding import Columns, Finding
from atoll_coordinator.data.columns.levels import check_few_levels, check_held_inputs
from atoll_coordinator.data.columns.maps import check_map
from atoll_coordinator.data.columns.relations import check_relations
from atoll_coordinator.data.columns.second_order import check_second_order
from atoll_coordinator.data.roles.roles import Roles, assign_roles
from atoll_coordinator.data.trajectories.measurements import Measurements, take_measurements
from atoll_core.config import DataConfig, JobConfig
from atoll_core.data.table import Table

Check = Callable[[Columns], Iterable[Finding]]

CHECKS: Final[Sequence[Check]] = (
    check_fill_values,
    check_clipping,
    check_few_levels,
    check_held_inputs,
    check_counters,
    check_relations,
    check_second_order,
    check_map,
)
"""Everything that columns are asked, in this order; each sees them without the values that stand for missing ones."""


@dataclass(frozen=True, eq=False)
class Examination:
    """Roles, options and measurements after what was found was acted on; `findings` are also among the warnings."""

    roles: Roles
    options: DataConfig
    measurements: Measurements
    findings: tuple[Finding, ...]


def examine(table: Table, config: JobConfig) -> Examination:
    """Return what the columns of a table are, what was measured, and what the columns say themselves.

    Raises UsageError where options contradict each other, DataError where the measurements cannot be used.
    """
    roles, options = assign_roles(table, config.data)
    if options.missing_values:
        table, options = _as_missing(table, roles, options), options.model_copy(update={"missing": "drop"})
    measurements = take_measurements(table, roles, options)
    columns = Columns.of(measurements, config.model_copy(update={"data": options}))
    findings = tuple(_found(columns))
    left_out = {name for finding in findings for name in finding.left_out}
    missing = [pair for finding in findings for pair in finding.missing if pair[0] not in left_out]
    if left_out:
        states = tuple(name for name in roles.states if name not in left_out)
        roles, options = replace(roles, states=states), options.model_copy(update={"states": states})
    if missing:
        table, options = _without(table, missing), options.model_copy(update={"missing": "drop"})
    if left_out or missing:
        measurements = take_measurements(table, roles, options)
    sentences = tuple(finding.sentence for finding in findings)
    measurements = replace(measurements, warnings=(*sentences, *measurements.warnings))
    return Examination(roles, options, measurements, findings)


def _found(columns: Columns) -> Iterable[Finding]:
    """Yield what each check finds; the later ones do not see values that stand for missing ones."""
    seen = columns.without({name: fill.value for name, fill in fill_values(columns).items()})
    for check in CHECKS:
        yield from check(columns if check is check_fill_values else seen)


def _as_missing(table: Table, roles: Roles, options: DataConfig) -> Table:
    """Return the table with the numbers that stand for missing values, in all that is measured, taken as such."""
    others = (roles.time, roles.trajectory, roles.group)
    is_measured = np.array([name not in others for name in table.names])
    is_missing = np.isin(table.columns, np.array(options.missing_values)) & is_measured[:, None]
    return replace(table, columns=np.where(is_missing, np.nan, table.columns))


def _without(table: Table, missing: Iterable[tuple[str, float]]) -> Table:
    """Return the table with one value of some columns taken as missing."""
    values = table.columns.copy()
    for name, value in missing:
        row = values[table.names.index(name)]
        row[row == value] = np.nan
    return replace(table, columns=values)
