"""What a job would search: its equations, what each may be made of, and when the search ends. Pure, and cheap."""

from collections.abc import Sequence
from dataclasses import dataclass

from atoll_coordinator.data.columns.examination import examine
from atoll_coordinator.data.prior_knowledge import resolve_equations
from atoll_coordinator.data.roles.roles import Roles, assign_symbols
from atoll_core.config import JobConfig
from atoll_core.data.table import Table


@dataclass(frozen=True)
class EquationOutline:
    """One equation: its left-hand side, and what it may be made of, or what it is if it is `known`."""

    lhs: str
    variables: tuple[str, ...]
    operators: tuple[str, ...]
    known: str | None = None
    guesses: tuple[str, ...] = ()

    def __str__(self) -> str:
        if self.known is not None:
            return f"{self.lhs} = {self.known} (known, not searched)"
        begins = f", beginning from {' or '.join(self.guesses)}" if self.guesses else ""
        return f"{self.lhs} = f({', '.join(self.variables)}) of {' '.join(self.operators)}{begins}"


@dataclass(frozen=True)
class Outline:
    """What a job would search in a table: names of `files`, how they were read, number of rows, equations, settings.

    `roles` are those of the columns, `warnings` what the columns say themselves.
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

    def as_text(self) -> str:
        """Return lines on what would be searched, and when the search would end."""
        searched = sum(equation.known is None for equation in self.equations)
        sought = "1 equation" if searched == 1 else f"{searched} equations"
        config, budget = self.config, self.config.budget
        effort = f"preset {config.preset}, seed {config.seed}, {config.evolution.islands} islands for each equation"
        ends = ["when it has converged or gets no better", f"after {budget.max_epochs} epochs at most"]
        ends += [f"after {epochs} of {name}" for name, epochs in budget.max_epochs_of.items()]
        ends += [] if budget.max_time is None else [f"after {budget.max_time:g} s"]
        if budget.target_error is not None:
            ends[0] = f"at a normalized error of {budget.target_error:g}, or when it gets no better"
        lines = [f"{sought} would be searched:", *(f"  {equation}" for equation in self.equations)]
        return "\n".join([*lines, effort, f"the search ends {', '.join(ends)}", "dry run: nothing was started"])

    def as_dict(self) -> dict[str, object]:
        """Return the same for other programs; `config` are the settings that are not defaults, as in a job file."""
        return {
            "files": list(self.files),
            "read_as": self.read_as,
            "rows": self.rows,
            "time": self.time,
            "units": self.units,
            "equations": [
                {key: list(value) if isinstance(value, tuple) else value for key, value in vars(equation).items()}
                for equation in self.equations
            ],
            "warnings": list(self.warnings),
            "config": self.config.model_dump(mode="json", exclude_defaults=True),
        }


def outline(table: Table, config: JobConfig) -> Outline:
    """Return what a job would search.

    Raises UsageError where options or what is known beforehand cannot be used, DataError where the columns cannot.
    """
    examination = examine(table, config)
    roles, options = examination.roles, examination.options
    symbols = assign_symbols(roles.variables)
    resolved, names = resolve_equations(config.model_copy(update={"data": options}), roles, symbols)
    stated_units = {**dict(zip(table.names, table.units, strict=True)), **options.units}
    units = {name: unit for name, unit in stated_units.items() if unit and name in roles.used}
    equations = tuple(_equation(resolved, roles, name, tuple(symbols.values())) for name in names)
    warnings = tuple(finding.sentence for finding in examination.findings)
    return Outline(table.files, table.read_as, table.rows, roles.time, units, equations, resolved, roles, warnings)


def _equation(config: JobConfig, roles: Roles, name: str, symbols: Sequence[str]) -> EquationOutline:
    columns = config.space.columns_for(name, symbols)
    return EquationOutline(
        roles.left_hand_side(name),
        tuple(symbols[column] for column in columns),
        config.space.operators_for(name),
        config.prior.known.get(name),
        config.prior.guesses.get(name, ()),
    )
