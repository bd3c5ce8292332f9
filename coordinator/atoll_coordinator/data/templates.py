"""The template of a job: the given equations of its configuration, over the symbols of its dataset; and whether a job
can have them. Pure."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from atoll_coordinator.data.roles.roles import RESERVED, Roles, assign_symbols, is_symbol
from atoll_core.config import JobConfig, ParameterConfig
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
    parameters = {name: parameter_of(name, one) for name, one in prior.parameters.items() if name not in prior.by_run}
    sides = {**prior.equations, **dict.fromkeys(prior.by_run, "0"), **config.data.observe}
    return read_template(sides, parameters, names, config.data.observe)


def parameter_of(name: str, given: ParameterConfig) -> TemplateParameter:
    """Return a parameter of a configuration."""
    return TemplateParameter(name, *given.ends, given.start)


def with_parameters_by_run(roles: Roles, config: JobConfig, columns: Sequence[str]) -> Roles:
    """Return the roles with a hidden state for each parameter that differs by run; its given rate is 0.

    Raises:
        UsageError: the name cannot be the name of a state, or a job of this kind can have no such parameter.
    """
    for name in config.prior.by_run:
        if name in columns or name in roles.hidden or not is_symbol(name):
            what = "a column" if name in columns else "a hidden state" if name in roles.hidden else "a function"
            raise UsageError(f"--parameter '{name} by run' has the name of {what}; choose another name")
        if name in config.prior.initial:
            raise UsageError(f"--initial names '{name}', a parameter; write its bounds with --parameter")
    if config.prior.by_run and roles.order == 2:
        example = '"dx/dt = x_dot" and "dx_dot/dt = -k*x"'
        raise UsageError(
            "a parameter by run and --order 2 exclude each other; write the velocity as a state of its own: "
            f"{example}, with --hidden x_dot if it was not measured"
        )
    return replace(roles, hidden=(*roles.hidden, *config.prior.by_run), by_run=config.prior.by_run)


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
                f"with {'a parameter by run' if roles.by_run else '--hidden'} every state needs a given equation, but "
                f"'{name}' has none; give one with --equation "
                f'"d{name}/dt=…" (? alone is an unknown one), or make it an input with --inputs {name}'
            )
    for name in roles.by_run:
        place = template.names.index(symbols[name])
        uses = any(place in variables_of(side) for side in template.sides.values())
        if not uses and not any(symbols[name] in (unknown.variables or ()) for unknown in template.unknowns):
            raise UsageError(f"--parameter {name} occurs in no --equation and no --observe; leave it out")
    unreached = next((name for name in roles.hidden if name not in _states_that_matter(template, roles, symbols)), None)
    if unreached is not None:
        what = "parameter" if unreached in roles.by_run else "hidden state"
        raise UsageError(
            f"nothing that is measured depends on the {what} '{unreached}', so that the data cannot determine "
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
