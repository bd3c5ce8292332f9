"""The template of a job: the given equations of its configuration, over the symbols of its dataset; and whether a job
can have them. Pure."""

import math
from collections.abc import Mapping, Sequence

from atoll_coordinator.data.roles.names_and_options import check_given_equations
from atoll_coordinator.data.roles.roles import RESERVED, Roles, assign_symbols
from atoll_core.config import JobConfig, ParameterConfig
from atoll_core.errors import UsageError
from atoll_core.expression.program import tree_size
from atoll_core.expression.template import EquationTemplate, TemplateParameter, read_template
from atoll_core.expression.text.infix import PRINTABLE_SIZE


def template_of(config: JobConfig, names: Sequence[str]) -> EquationTemplate | None:
    """Return the template over the symbols `names`; None if no equation is given with ``--equation``.

    `config` is resolved: its equations are keyed by variable.

    Raises:
        UsageError: see `read_template`.
    """
    prior = config.prior
    if not prior.equations and not prior.parameters:
        return None
    return read_template(prior.equations, parameters_of(prior.parameters), names)


def parameters_of(given: Mapping[str, ParameterConfig]) -> dict[str, TemplateParameter]:
    """Return the parameters of a configuration, by name."""
    return {
        name: TemplateParameter(
            name,
            -math.inf if one.lower is None else one.lower,
            math.inf if one.upper is None else one.upper,
            one.start,
            one.by_group,
        )
        for name, one in given.items()
    }


def check_names(config: JobConfig, columns: Sequence[str], roles: Roles) -> None:
    """Raise UsageError if a job of this kind can have no given equations, or if a parameter has the name of a column.

    Such a column is no variable: the time, or a column without a role.
    """
    check_given_equations(config)
    template = template_of(config, tuple(assign_symbols(roles.variables).values()))
    for parameter in () if template is None else template.parameters:
        name = parameter.name
        if name == roles.time:
            raise UsageError(f"--equation uses the time {name}, which is no variable; add --inputs {name}")
        if name in columns:
            raise UsageError(
                f"--equation uses {name}, a column that is neither a state nor an input; name it with --inputs, or "
                "rename the parameter"
            )


def check_template(template: EquationTemplate) -> None:
    """Raise UsageError for names that no parameter may have, and for unknown parts that the data cannot determine."""
    reserved = next((one.name for one in template.parameters if one.name in RESERVED), None)
    if reserved is not None:
        raise UsageError(f"--equation uses {reserved}, the name of a function, as a parameter; choose another name")
    for equation, side in template.sides.items():
        if tree_size(side) > PRINTABLE_SIZE:
            raise UsageError(f"--equation for '{equation}' has more than {PRINTABLE_SIZE} operations when written out")
        for place in template.unknowns_in(equation):
            label = template.unknowns[place].label
            if template.solved_for(equation, place) is None:
                raise UsageError(
                    f"--equation for '{equation}' has {label} in more than one place, or inside sin, cos, abs or an "
                    f"even power, whose value does not determine {label}; write {label} once, for the whole of it"
                )
