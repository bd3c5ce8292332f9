"""The units of parameters and unknown parts of given equations, and given terms with impossible units. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from atoll_coordinator.data.roles.roles import Roles, assign_symbols
from atoll_coordinator.data.templates import template_of
from atoll_coordinator.dimensions import rate_unit, units_of_columns, units_of_sides
from atoll_coordinator.units import Unit
from atoll_core.config import JobConfig
from atoll_core.expression.template import EquationTemplate


@dataclass(frozen=True)
class TemplateUnits:
    """What follows for units from given equations together; units that do not follow are missing.

    `parameters` are by name, `unknowns` by home. `faults` are clauses about terms with impossible units, by equation.
    """

    parameters: Mapping[str, Unit] = field(default_factory=dict)
    unknowns: Mapping[str, Unit] = field(default_factory=dict)
    faults: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def units_of_template(config: JobConfig, roles: Roles, units: Mapping[str, str]) -> TemplateUnits:
    """Return the units of parameters and unknown parts, and the faults.

    Args:
        config: the configuration.
        roles: the roles of the columns.
        units: units of columns as texts, from options and headers.
    """
    columns = units_of_columns({name: text for name, text in units.items() if text}, config.data.angles)
    template = template_of(config, tuple(assign_symbols(roles.variables).values()))
    if not columns or not template.sides:
        return TemplateUnits()
    of_unknowns = {f"? of {unknown.home}": unknown.home for unknown in template.unknowns}
    found, faults = _solve(template, roles, columns, [*of_unknowns])
    return TemplateUnits(
        {one.name: found[one.name] for one in template.parameters if one.name in found},
        {home: found[name] for name, home in of_unknowns.items() if name in found},
        faults,
    )


def _solve(
    template: EquationTemplate, roles: Roles, columns: Mapping[str, Unit], unknowns: list[str]
) -> tuple[dict[str, Unit], dict[str, tuple[str, ...]]]:
    time, symbols = columns.get(roles.time or ""), assign_symbols(roles.variables)
    velocities = dict(zip(roles.velocities, roles.states, strict=False))
    known = {
        symbols[name]: unit
        for name in roles.variables
        if (unit := rate_unit(columns.get(velocities[name]), time, 1) if name in velocities else columns.get(name))
    }
    rates = {name: rate_unit(columns.get(name), time, roles.order) for name in template.sides}
    rates |= {name: columns.get(name) for name in template.observed}
    lefts = {name: unit for name, unit in rates.items() if unit is not None}
    names = [*template.names, *(parameter.name for parameter in template.parameters), *unknowns]
    return units_of_sides(template.sides, names, known, lefts)
