"""Text for users before a job: how a table was read (`describe`), and the equations of a search (`outline`). Pure.

Both are cheap: nothing is smoothed or compiled.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.data.columns.examination import Examination, examine
from atoll_coordinator.data.prior_knowledge import resolve_equations
from atoll_coordinator.data.roles.roles import Roles, assign_symbols
from atoll_coordinator.data.template_units import units_of_template
from atoll_coordinator.data.templates import parameter_of, template_of
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.units import Unit
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.expression.template import EquationTemplate, TemplateParameter
from atoll_core.expression.text.export import GIVEN_DIGITS, left_side_to_mathml, to_mathml

_ONLY_GIVEN: Final = ("given", "unknown", "mathml", "unit")
"""Keys of an equation that is given with ``--equation``; other equations do not have them."""


@dataclass(frozen=True)
class EquationOutline:
    """One equation: its left-hand side, its variables and operators, or its expression if it is `known`.

    If a part of it is `given`, `unknown` is the part that is searched, with these variables and operators; "" if
    nothing is searched under the name of this equation. `mathml` is the given equation, `unit` the unit of its unknown
    part if it follows from the units of the columns.
    """

    lhs: str
    variables: tuple[str, ...]
    operators: tuple[str, ...]
    known: str | None = None
    guesses: tuple[str, ...] = ()
    given: str | None = None
    unknown: str = ""
    mathml: str = ""
    unit: str | None = None

    @property
    def is_searched(self) -> bool:
        """Whether the equation or a part of it is searched."""
        return self.known is None and (self.given is None or bool(self.unknown))

    def __str__(self) -> str:
        if self.known is not None:
            return f"{self.lhs} = {self.known} (known, not searched)"
        if self.given is not None and not self.unknown:
            return f"{self.lhs} = {self.given} (given)"
        begins = f", beginning from {' or '.join(self.guesses)}" if self.guesses else ""
        means = f" of {' '.join(self.operators)}{begins}"
        if self.given is None:
            return f"{self.lhs} = f({', '.join(self.variables)}){means}"
        unit = f" [{self.unit}]" if self.unit is not None else ""
        searched = f"searched: {self.unknown}{unit} of {self.lhs}, from {', '.join(self.variables)},{means}"
        return f"{self.lhs} = {self.given}\n    {searched}"

    def as_dict(self) -> dict[str, object]:
        """Return the fields; those of a given equation only if it is given."""
        left_out = _ONLY_GIVEN if self.given is None else ()
        fields = {key: value for key, value in vars(self).items() if key not in left_out}
        return {key: list(value) if isinstance(value, tuple) else value for key, value in fields.items()}


@dataclass(frozen=True)
class Outline:
    """The planned search: names of `files`, how they were read, number of rows, equations, settings.

    `roles` are the roles of the columns, `warnings` the findings of their examination, `parameters` describes the
    parameters of given equations.
    """

    files: tuple[str, ...]
    read_as: str
    rows: int
    time: str | None
    units: dict[str, str]
    equations: tuple[EquationOutline, ...]
    config: JobConfig
    roles: Roles
    warnings: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()

    def as_text(self) -> str:
        """Return lines that list the equations to be searched, and when the search would end."""
        searched = sum(equation.is_searched for equation in self.equations)
        sought = "1 equation" if searched == 1 else f"{searched} equations"
        config, budget = self.config, self.config.budget
        effort = f"preset {config.preset}, seed {config.seed}, {config.evolution.islands} islands for each equation"
        ends = ["when it has converged or gets no better", f"after {budget.max_epochs} epochs at most"]
        ends += [f"after {epochs} of {name}" for name, epochs in budget.max_epochs_of.items()]
        ends += [] if budget.max_time is None else [f"after {budget.max_time:g} s"]
        if budget.target_error is not None:
            ends[0] = f"at a normalized error of {budget.target_error:g}, or when it gets no better"
        lines = [f"{sought} would be searched:", *(f"  {equation}" for equation in self.equations)]
        lines += [f"  parameter {parameter}" for parameter in self.parameters]
        return "\n".join([*lines, effort, f"the search ends {', '.join(ends)}", "dry run: nothing was started"])

    def as_dict(self) -> dict[str, object]:
        """Return the outline for other programs.

        `config` has the settings that differ from the defaults, as in a job file.
        """
        parameters = {"parameters": list(self.parameters)}
        return {
            "files": list(self.files),
            "read_as": self.read_as,
            "rows": self.rows,
            "time": self.time,
            "units": self.units,
            "equations": [equation.as_dict() for equation in self.equations],
            **(parameters if self.parameters else {}),
            "warnings": list(self.warnings),
            "config": self.config.model_dump(mode="json", exclude_defaults=True),
        }


def outline(table: Table, config: JobConfig) -> Outline:
    """Return the equations that a job would search, and its settings.

    Raises UsageError if options or prior knowledge cannot be used, DataError if the columns cannot be used.
    """
    examination, resolved, names, units = _resolved(table, config)
    roles = examination.roles
    symbols = tuple(assign_symbols(roles.variables).values())
    template, implied = template_of(resolved, symbols), units_of_template(resolved, roles, units)
    equations = tuple(
        EquationOutline(
            roles.left_hand_side(name),
            tuple(symbols[column] for column in resolved.space.columns_for(name, symbols)),
            resolved.space.operators_for(name),
            resolved.prior.known.get(name),
            resolved.prior.guesses.get(name, ()),
            *_given_part(template, name, roles.left_hand_side(name)),
            None if (unit := implied.unknowns.get(name)) is None else str(unit),
        )
        for name in names
        if name not in roles.by_run
    )
    used = {name: unit for name, unit in units.items() if unit and name in roles.used}
    warnings = tuple(finding.sentence for finding in examination.findings)
    described = tuple(_describe(one, implied.parameters.get(one.name)) for one in template.parameters)
    given = {f"{name}, by run": resolved.prior.parameters[name] for name in roles.by_run}
    described += tuple(_describe(parameter_of(name, one), None) for name, one in given.items())
    return Outline(
        table.files, table.read_as, table.rows, roles.time, used, equations, resolved, roles, warnings, described
    )


def _given_part(template: EquationTemplate, name: str, lhs: str) -> tuple[str | None, str, str]:
    """Return the given side of an equation (None: not given), its unknown part, and the equation in MathML."""
    if name not in template.sides:
        return None, "", ""
    labels = [unknown.label for unknown in template.unknowns]
    names = [*template.names, *(parameter.name for parameter in template.parameters), *labels]
    unknown = template.unknown_of(name)
    side = to_mathml(template.sides[name], names, digits=GIVEN_DIGITS, is_given=True)
    sides = f"{left_side_to_mathml(lhs)}<mo>=</mo>{side}"
    mathml = f'<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">{sides}</math>'
    return template.texts[name], "" if unknown is None else unknown.label, mathml


def _describe(parameter: TemplateParameter, unit: Unit | None) -> str:
    """Return a parameter with its unit, its bounds and the value at which its fit begins."""
    lower, upper = parameter.lower, parameter.upper
    if math.isinf(lower):
        bounds = "" if math.isinf(upper) else f"at most {upper:g}, "
    else:
        bounds = f"at least {lower:g}, " if math.isinf(upper) else f"{lower:g} to {upper:g}, "
    name = parameter.name if unit is None else f"{parameter.name} [{unit}]"
    return f"{name}: {bounds}beginning at {parameter.first_value:g}"


def describe(table: Table, config: JobConfig, *, has_warnings: bool = True) -> str:
    """Return lines on files, how they were read, trajectories, rows, time, columns and prior knowledge.

    With `has_warnings`, the findings about the columns follow.

    Raises UsageError if options or prior knowledge cannot be used, DataError if the measurements cannot be used.
    """
    examination, resolved, _, units = _resolved(table, config)
    roles, measurements = examination.roles, examination.measurements

    def with_unit(name: str) -> str:
        return f"{name} [{units[name]}]" if units.get(name) else name

    files = ", ".join(table.files) if len(table.files) <= 3 else f"{len(table.files)} files"
    count = len(measurements.ranges)
    trajectories = f"{count} trajectories, " if count > 1 else ""
    used = f" ({measurements.row_count} usable)" if measurements.row_count < table.rows else ""
    lines = [f"{files}: {trajectories}{table.rows} rows{used}"]
    if table.read_as:
        lines.append(f"read as {table.read_as}")
    if roles.time is not None:
        lines.append(f"time {with_unit(roles.time)}: {_times(measurements, roles.time)}")
    states = tuple(name for name in roles.states if name not in roles.observed)
    hidden = tuple(name for name in roles.hidden if name not in roles.by_run)
    named = [("states", states), ("hidden states", hidden), ("derivatives", roles.derivatives)]
    named += [("inputs", roles.inputs), ("parameters by run", roles.by_run)]
    if roles.target is not None:
        named = [("target", (roles.target,)), ("inputs", roles.inputs)]
    named.append(("weights", () if roles.weights is None else (roles.weights,)))
    lines += [f"{role}: {', '.join(map(with_unit, names))}" for role, names in named if names]
    if measurements.group_names:
        lines.append(f"constants may differ between {len(measurements.group_names)} groups of trajectories")
    prior, side = resolved.prior, roles.left_hand_side
    lines += [f"known: {side(name)} = {text}" for name, text in prior.known.items()]
    lines += [f"given: {side(name)} = {text}" for name, text in prior.equations.items()]
    lines += [f"observed: {with_unit(name)} = {text}" for name, text in resolved.data.observe.items()]
    lines += [f"guess: {side(name)} = {text}" for name, texts in prior.guesses.items() for text in texts]
    lines += [f"required: {side(name)} has {', '.join(names)}" for name, names in resolved.space.required_of.items()]
    lines += [f"bounds: {side(name)}: {'; '.join(texts)}" for name, texts in prior.bounds.items()]
    lines += [f"shape: {side(name)}: {'; '.join(prior.shapes_of(name))}" for name in prior.shaped]
    lines += [f"warning: {finding.sentence}" for finding in examination.findings if has_warnings]
    return "\n".join(lines)


def _resolved(table: Table, config: JobConfig) -> tuple[Examination, JobConfig, tuple[str, ...], Mapping[str, str]]:
    examination = examine(table, config)
    symbols = assign_symbols(examination.roles.variables)
    config = config.model_copy(update={"data": examination.options})
    resolved, equations = resolve_equations(config, examination.roles, symbols)
    units = dict(zip(table.names, table.units, strict=True)) | examination.options.units
    return examination, resolved, equations, units


def _times(measurements: Measurements, name: str) -> str:
    """Return range and step of the times, such as ``0 to 9.98, step 0.02``."""
    times = measurements.columns[name]
    steps = np.sort(np.concatenate([np.diff(times[first:last]) for first, last in measurements.ranges]))
    text = f"{float(np.min(times)):g} to {float(np.max(times)):g}"
    if not len(steps):
        return text
    low, high, middle = float(steps[0]), float(steps[-1]), float(steps[len(steps) // 2])
    is_even = high - low <= 1e-6 * abs(middle) + 8.0 * float(np.spacing(np.max(np.abs(times))))
    return f"{text}, step {middle:g}" if is_even else f"{text}, steps {low:g} to {high:g}"
