"""The template of a job: the given equations of its configuration, over the symbols of its dataset; and whether a job
can have them. Pure."""

from collections.abc import Collection, Mapping, Sequence

from atoll_coordinator.data.roles.roles import RESERVED, Roles, assign_symbols
from atoll_core.config import JobConfig
from atoll_core.errors import UsageError
from atoll_core.expression.program import tree_size, variables_of
from atoll_core.expression.template import EquationTemplate, TemplateParameter, option_for, read_template
from atoll_core.expression.text.infix import PRINTABLE_SIZE
from atoll_core.quoting import did_you_mean


def template_of(config: JobConfig, names: Sequence[str]) -> EquationTemplate:
    """Return the template over the symbols `names`; it has no sides without ``--equation`` and ``--observe``.

    `config` is resolved: its equations are keyed by variable.

    Raises:
        UsageError: see `read_template`.
    """
    prior = config.prior
    if not prior.equations and not prior.parameters and not config.data.observe:
        return EquationTemplate(tuple(names))
    parameters = {name: TemplateParameter(name, *one.ends, one.start) for name, one in prior.parameters.items()}
    return read_template({**prior.equations, **config.data.observe}, parameters, names, config.data.observe)


def check_names(config: JobConfig, columns: Sequence[str], roles: Roles) -> None:
    """Raise UsageError if a parameter has the name of a column that is no variable: the time, or a column without a
    role."""
    template = template_of(config, tuple(assign_symbols(roles.variables).values()))
    option = _options_of(config.data.observe)
    for parameter in template.parameters:
        name = parameter.name
        if name == roles.time:
            raise UsageError(f"{option} uses the time {name}, which is no variable; add --inputs {name}")
        if name in columns:
            raise UsageError(
                f"{option} uses {name}, a column that is neither a state nor an input; name it with --inputs, or "
                "rename the parameter"
            )


def _options_of(observed: Collection[str]) -> str:
    return "--equation or --observe" if observed else "--equation"


def check_template(template: EquationTemplate) -> None:
    """Raise UsageError for names that no parameter may have, and for unknown parts that the data cannot determine."""
    reserved = next((one.name for one in template.parameters if one.name in RESERVED), None)
    if reserved is not None:
        option = _options_of(template.observed)
        raise UsageError(f"{option} uses {reserved}, the name of a function, as a parameter; choose another name")
    for equation, side in template.sides.items():
        if tree_size(side) > PRINTABLE_SIZE:
            option = option_for(equation, template.observed)
            raise UsageError(f"{option} has more than {PRINTABLE_SIZE} operations when written out")
        for place in template.unknowns_in(equation):
            label = template.unknowns[place].label
            if template.solved_for(equation, place) is None:
                raise UsageError(
                    f"--equation for '{equation}' has {label} in more than one place, or inside sin, cos, abs or a "
                    f"power such as {label}**2, whose value does not determine {label}; write {label} once, for the "
                    "whole of it"
                )


def check_hidden_states(template: EquationTemplate, roles: Roles, symbols: Mapping[str, str]) -> None:
    """Raise UsageError if a hidden state has no given equation, or if nothing that is measured depends on it."""
    for name in roles.hidden:
        if name not in template.sides:
            raise UsageError(
                f"--hidden names '{name}', which has no equation; give one with --equation \"d{name}/dt=…\", or leave "
                "--hidden out"
            )
    if not roles.hidden:
        return
    for name in roles.states:
        if name not in roles.observed and name not in template.sides:
            raise UsageError(
                f"with --hidden every state needs a given equation, but '{name}' has none; give one with --equation "
                f'"d{name}/dt=…" (? alone is an unknown one), or make it an input with --inputs {name}'
            )
    unreached = next((name for name in roles.hidden if name not in _states_that_matter(template, roles, symbols)), None)
    if unreached is not None:
        raise UsageError(
            f"nothing that is measured depends on the hidden state '{unreached}', so that the data cannot determine "
            "it; leave its equation out"
        )


def _states_that_matter(template: EquationTemplate, roles: Roles, symbols: Mapping[str, str]) -> set[str]:
    """Return the hidden states on which a measured column depends, directly or through other states.

    An unknown part may depend on every state.
    """
    index = {name: template.names.index(symbols[name]) for name in roles.hidden}
    reached, waiting = set[str](), list(roles.states)
    while waiting:
        used = variables_of(template.sides[waiting.pop()])
        if any(one >= len(template.names) + len(template.parameters) for one in used):
            return set(roles.hidden)
        new = {name for name, place in index.items() if place in used} - reached
        reached |= new
        waiting += new
    return reached


def check_initial_values(config: JobConfig, variables: Sequence[str]) -> None:
    """Raise UsageError if an initial value belongs to no state with an equation."""
    given = config.prior.initial
    if given and not (config.prior.equations or config.data.hidden):
        raise UsageError("--initial belongs to given equations; add --equation, or leave --initial out")
    for name in given:
        if name not in variables:
            known = ", ".join(variables)
            raise UsageError(f"--initial names '{name}', but the states are {known}{did_you_mean(name, variables)}")
