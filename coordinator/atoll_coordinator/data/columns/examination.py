"""Runs all checks of columns in order, and acts on their findings if this is safe. Pure."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_coordinator.data.columns.examined_columns import ColumnFinding, ExaminedColumns
from atoll_coordinator.data.columns.motion import check_map, check_second_order
from atoll_coordinator.data.columns.values import (
    check_clipping,
    check_counters,
    check_few_levels,
    check_fill_values,
    check_held_inputs,
    check_relations,
    fill_values,
)
from atoll_coordinator.data.prior_knowledge import resolve_equations
from atoll_coordinator.data.roles.roles import Roles, assign_roles, assign_symbols
from atoll_coordinator.data.template_units import units_of_template
from atoll_coordinator.data.templates import check_names, with_parameters_by_run
from atoll_coordinator.data.trajectories.measurements import Measurements, take_measurements
from atoll_core.config import DataConfig, JobConfig
from atoll_core.data.table import Table

CHECKS: Final[Sequence[Callable[[ExaminedColumns], Iterable[ColumnFinding]]]] = (
    check_clipping,
    check_few_levels,
    check_held_inputs,
    check_counters,
    check_relations,
    check_second_order,
    check_map,
)
"""The checks after `check_fill_values`, in order. In the columns that these checks examine, the fill values found by
`check_fill_values` are treated as missing."""


@dataclass(frozen=True, eq=False)
class Examination:
    """Roles, options and measurements, changed as the findings require; the `findings` are also among the warnings."""

    roles: Roles
    options: DataConfig
    measurements: Measurements
    findings: tuple[ColumnFinding, ...]


def examine(table: Table, config: JobConfig) -> Examination:
    """Return the roles of the columns of a table, the measurements, and the findings.

    Raises UsageError if options contradict each other, DataError if the measurements cannot be used.
    """
    roles, options = assign_roles(table, config.data)
    roles = with_parameters_by_run(roles, config, (*table.names, *table.skipped))
    check_names(config, (*table.names, *table.skipped), roles)
    if options.missing_values:  # these values are missing in all measured columns
        is_measured = np.array([name not in (roles.time, roles.trajectory, roles.group) for name in table.names])
        is_missing = np.isin(table.columns, np.array(options.missing_values)) & is_measured[:, None]
        table = replace(table, columns=np.where(is_missing, np.nan, table.columns))
        options = options.model_copy(update={"missing": "drop"})
    measurements = take_measurements(table, roles, options)
    columns = ExaminedColumns.of(measurements, config.model_copy(update={"data": options}))
    without_fill = columns.without(fill_values(columns))
    findings = (*check_fill_values(columns), *(finding for check in CHECKS for finding in check(without_fill)))
    left_out = {name for finding in findings for name in finding.left_out}
    missing = [pair for finding in findings for pair in finding.missing if pair[0] not in left_out]
    if left_out:
        states = tuple(name for name in roles.states if name not in left_out)
        roles, options = replace(roles, states=states), options.model_copy(update={"states": states})
    if missing:
        values = table.columns.copy()
        for name, value in missing:
            row = values[table.names.index(name)]
            row[row == value] = np.nan
        table, options = replace(table, columns=values), options.model_copy(update={"missing": "drop"})
    if left_out or missing:
        measurements = take_measurements(table, roles, options)
    findings = (*findings, *_check_units(table, config.model_copy(update={"data": options}), roles))
    sentences = tuple(finding.sentence for finding in findings)
    measurements = replace(measurements, warnings=(*sentences, *measurements.warnings))
    return Examination(roles, options, measurements, findings)


def _check_units(table: Table, config: JobConfig, roles: Roles) -> Iterable[ColumnFinding]:
    """Yield a finding for each given equation, or observed column, that contradicts the units of the columns."""
    if not config.prior.equations and not config.data.observe:
        return
    resolved, _ = resolve_equations(config, roles, assign_symbols(roles.variables))
    units = dict(zip(table.names, table.units, strict=True)) | config.data.units
    for name, faults in units_of_template(resolved, roles, units).faults.items():
        found = f"The units in the given equation of '{name}' contradict each other: {'; '.join(faults)}"
        yield ColumnFinding(found, "correct the equation, or the units with --unit")
