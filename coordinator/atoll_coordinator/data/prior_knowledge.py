"""Prior knowledge in terms of the data: guesses, known and given equations, bounds, allowed, required symbols. Pure.

Several forms of left-hand sides are accepted. The equation of ``x`` may be called ``x``, ``dx``, ``dx/dt`` or ``x'``,
for order 2 ``d2x``, ``d2x/dt2`` or ``x''``. Columns may be called by their name or by their symbol. If a column is
itself called ``dx``, this name means the column and not the derivative of ``x``. Unusable prior knowledge is refused
before a search, with one sentence for the user.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, combinations_with_replacement
from typing import Final, TypeVar

import numpy as np

from atoll_coordinator.data.recording import component_name
from atoll_coordinator.data.roles.names_and_options import check_given_equations, split_unit
from atoll_coordinator.data.roles.roles import Roles
from atoll_coordinator.data.templates import check_hidden_states, check_initial_values, check_template, template_of
from atoll_core.config import JobConfig, PriorConfig, SpaceConfig
from atoll_core.data.dataset import Dataset
from atoll_core.errors import UsageError
from atoll_core.expression.operation_list import placed_text
from atoll_core.expression.operators import BY_NAME, VARIABLE
from atoll_core.expression.program import Program, tree_size
from atoll_core.expression.restrictions import ALL_EQUATIONS, parse_bound
from atoll_core.expression.shapes import read_shapes
from atoll_core.expression.simplification import complexity, simplify_program
from atoll_core.expression.template import EquationTemplate
from atoll_core.expression.text.infix import PRINTABLE_SIZE
from atoll_core.expression.text.parsing import from_infix
from atoll_core.quoting import did_you_mean

Value = TypeVar("Value")

_INDIVIDUALS_PER_GUESS: Final = 4
"""At most one individual in this many begins as a guess; more guesses are refused."""
_FORMS: Final = {1: r"d{0}(/d\w+)?|{0}'", 2: r"d2{0}(/d\w+?(\^|\*\*)?2)?|{0}''"}
"""Regular expressions of left-hand sides by the order of the derivative; {0} is the escaped name."""
_ORDINALS: Final = {1: "first", 2: "second"}


@dataclass(frozen=True)
class LeftSides:
    """The equations of a job: `variables` are their names; `order` is None if no state is differentiated.

    `symbols` has the symbol of each column that expressions may use, in the order of the dataset's rows.
    """

    variables: tuple[str, ...]
    symbols: Mapping[str, str]
    order: int | None

    def several(self, option: str, by_side: Mapping[str, Value]) -> dict[str, tuple[Value, ...]]:
        """Return the values in `by_side` for each variable, in the order of the variables.

        Raises UsageError, which names `option`, if a left-hand side belongs to no variable.
        """
        pairs = [(self.variable(option, text), value) for text, value in by_side.items()]
        named = {name for name, _ in pairs}
        return {
            name: tuple(value for other, value in pairs if other == name) for name in self.variables if name in named
        }

    def single(self, option: str, by_side: Mapping[str, Value]) -> dict[str, Value]:
        """Return the value in `by_side` for each variable.

        Raises UsageError as `several` does, and for a variable named twice.
        """
        several = self.several(option, by_side)
        twice = next((name for name, values in several.items() if len(values) > 1), None)
        if twice is not None:
            raise UsageError(f"{option} names the equation of '{twice}' twice; give one")
        return {name: value for name, (value,) in several.items()}

    def variable(self, option: str, text: str) -> str:
        """Return the variable that the left-hand side `text` belongs to; raises UsageError, which names `option`."""
        text = text.strip()
        for name in (text, split_unit(text)[0]):
            if name in self.variables:
                return name
        named = [name for name in self.variables if self.symbols.get(name) == text]
        fitting = named or [name for name in self.variables if self._is_derivative(text, name, self.order)]
        if fitting:
            return fitting[0]
        sought = f"equations are searched for {', '.join(self.variables)}{did_you_mean(text, self.variables)}"
        for order in _FORMS:
            if not any(self._is_derivative(text, name, order) for name in self.variables):
                continue
            sought = f"{', '.join(self.variables)} is the left-hand side itself, not a derivative; use this name"
            if self.order is not None:
                other = "leave --order 2 out" if self.order == 2 else "add --order 2"
                form = f"d{'2' * (self.order == 2)}x=…"
                sought = f"{_ORDINALS[self.order]} derivatives are searched; write {form}, or {other}"
            raise UsageError(f"{option} names '{text}', a {_ORDINALS[order]} derivative, but {sought}")
        raise UsageError(f"{option} names '{text}', but {sought}")

    def symbols_of(self, option: str, texts: Sequence[str]) -> tuple[str, ...]:
        """Return the symbols of variables named by column or symbol; raises UsageError, which names `option`."""
        known = ", ".join(self.symbols)
        if not texts:
            raise UsageError(f"{option} names no variable for an equation; name at least one of {known}")
        symbols: list[str] = []
        for text in texts:
            name = next((name for name in (text, split_unit(text)[0]) if name in self.symbols), None)
            if name is None and text not in self.symbols.values():
                hint = did_you_mean(text, self.symbols)
                raise UsageError(f"{option} names '{text}', but the variables are {known}{hint}")
            symbols.append(text if name is None else self.symbols[name])
        return tuple(dict.fromkeys(symbols))

    def _is_derivative(self, text: str, name: str, order: int | None) -> bool:
        if order is None:
            return False
        names = dict.fromkeys((name, self.symbols.get(name, name)))
        return any(re.fullmatch(_FORMS[order].format(re.escape(spelling)), text) for spelling in names)


def resolve_equations(config: JobConfig, roles: Roles, symbols: Mapping[str, str]) -> tuple[JobConfig, tuple[str, ...]]:
    """Return the resolved configuration (see `resolve_prior`) and the equations of the job, in order.

    These are the searched equations (all unless ``--only`` names some), the known and the given equations. For a
    stochastic process every component of its diffusion is included, although the data may not determine all of them.
    Raises UsageError.
    """
    names = roles.equations
    if config.data.stochastic:
        names = (*names, *(component_name(*pair) for pair in combinations_with_replacement(roles.states, 2)))
    sides, only = _sides(config, names, symbols), config.data.only
    given = sides.single("--known", config.prior.known) | sides.single("--equation", config.prior.equations)
    given |= dict.fromkeys(roles.by_run, "0")
    equations = tuple(name for name in names if not only or name in only or name in given)
    resolved = resolve_prior(config, equations, symbols)
    if not config.data.hidden_count:
        check_hidden_states(template_of(resolved, tuple(symbols.values())), roles, symbols)
    return resolved, equations


def resolve_prior(config: JobConfig, variables: Sequence[str], symbols: Mapping[str, str]) -> JobConfig:
    """Return `config` with checked prior knowledge: keys are variables, allowed variables are symbols.

    Args:
        config: The configuration as submitted; a resolved configuration is returned unchanged.
        variables: Names of the job's equations, including known and given equations.
        symbols: Symbol of each column that expressions may use, in the order of the dataset's rows.

    Raises:
        UsageError: A left-hand side, name or operator does not exist or is given twice, an expression cannot be read,
            or a guess does not fit the operation lists of its equation.
    """
    check_initial_values(config, variables)
    sides, names = _sides(config, variables, symbols), tuple(symbols.values())
    known = sides.single("--known", config.prior.known)
    for name, text in known.items():
        _known_program(name, text, names)
    guesses = _texts(sides, "--guess", config.prior.guesses)
    allowed = sides.single("--allow", config.space.variables_of)
    required = sides.single("--require", config.space.required_of)
    space = config.space.model_copy(
        update={
            "operators_of": sides.single("--operators", config.space.operators_of),
            "required_of": {name: sides.symbols_of("--require", texts) for name, texts in required.items()},
            "variables_of": {name: sides.symbols_of("--allow", texts) for name, texts in allowed.items()},
        }
    )
    equations = sides.single("--equation", config.prior.equations)
    template = _checked_template(config, equations, known, names)
    by_run = [symbols[name] for name in config.prior.by_run]
    space = space.model_copy(update={"variables_of": _variables_of_unknowns(template, space.variables_of, by_run)})
    given = [name for name in variables if template.is_given(name)]
    sought = [name for name in variables if name not in known and name not in given]
    bounds = _resolved_bounds(config.prior.bounds, sides, sought)
    shapes = _resolved_shapes(config.prior, sides, template)
    by_option = {
        "--guess": guesses,
        "--operators": space.operators_of,
        "--allow": space.variables_of,
        "--require": space.required_of,
        "--bound": bounds,
        **shapes,
    }
    _check_searched(by_option, known, given, template)
    for name, needed in space.required_of.items():
        usable = [names[column] for column in space.columns_for(name, names)]
        excluded = next((symbol for symbol in needed if symbol not in usable), None)
        if excluded is not None:
            raise UsageError(
                f"--require wants {excluded} in the equation of '{name}', but --allow lets it use "
                f"{', '.join(usable)} only; change one of the two"
            )
    _check_shapes(shapes, space, names)
    prior = PriorConfig(
        guesses=guesses,
        known=known,
        bounds=bounds,
        equations=equations,
        parameters=config.prior.parameters,
        initial=config.prior.initial,
        positive=tuple(shapes["--positive"]),
        monotone=shapes["--monotone"],
        limits=shapes["--limit"],
    )
    resolved = config.model_copy(update={"prior": prior, "space": space})
    for name, texts in guesses.items():
        _check_guesses(resolved, name, texts, names)
    return resolved


def known_programs(dataset: Dataset, config: JobConfig, parameters: Sequence[float] = ()) -> dict[str, Program]:
    """Return the programs of the known equations by variable, in the order in which they are targets of the dataset.

    Sides of the job's template in which nothing is searched are also known equations, with these values (P,) of the
    `parameters`; empty: their start values. `config` is resolved. Raises UsageError if an equation is not an expression
    over the dataset's symbols.
    """
    known, template = config.prior.known, template_of(config, dataset.names)
    values = np.array(parameters) if len(parameters) else template.starts
    return {
        name: _known_program(name, known[name], dataset.names)
        if name in known
        else template.given_program(name, values)
        for name in dataset.variables
        if name in known or template.is_given(name)
    }


def guessed_programs(dataset: Dataset, config: JobConfig) -> dict[str, tuple[Program, ...]]:
    """Return the programs of the guesses by variable, with their constants.

    `config` is resolved. Raises UsageError if a guess is not an expression over the dataset's symbols.
    """
    guesses = config.prior.guesses
    return {
        name: tuple(simplify_program(_parsed("--guess", name, text, dataset.names)) for text in guesses[name])
        for name in dataset.variables
        if name in guesses
    }


def _checked_template(
    config: JobConfig, equations: Mapping[str, str], known: Mapping[str, str], names: Sequence[str]
) -> EquationTemplate:
    """Return the template of these sides by variable. Raises UsageError if no job can have it."""
    check_given_equations(config)
    both = next((name for name in equations if name in known), None)
    if both is not None:
        raise UsageError(f"--known and --equation both give the equation of '{both}'; leave one of the two out")
    both = next((name for name in config.prior.by_run if name in equations or name in known), None)
    if both is not None:
        raise UsageError(f"--parameter '{both} by run' is constant in each run; leave the equation of '{both}' out")
    prior = config.prior.model_copy(update={"equations": equations})
    template = template_of(config.model_copy(update={"prior": prior}), names)
    check_template(template)
    return template


def _variables_of_unknowns(
    template: EquationTemplate, allowed: Mapping[str, tuple[str, ...]], by_run: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return the allowed variables by equation, with the variables that unknowns name: ``?(v, u)``.

    An unknown part may depend on a parameter that differs by run only if the user names the parameter.
    """
    variables = dict(allowed)
    for unknown in template.unknowns:
        if unknown.variables is None:
            if by_run:
                others = tuple(name for name in template.names if name not in by_run)
                variables.setdefault(unknown.home, others)
            continue
        others = variables.setdefault(unknown.home, unknown.variables)
        if set(others) != set(unknown.variables):
            written = f"{unknown.label}({', '.join(unknown.variables)})"
            raise UsageError(
                f"--allow lets the unknown part of '{unknown.home}' use {', '.join(others)}, but --equation has "
                f"{written}; leave one of the two out"
            )
    return variables


def _resolved_shapes(
    prior: PriorConfig, sides: LeftSides, template: EquationTemplate
) -> dict[str, dict[str, tuple[str, ...]]]:
    """Return the shapes by option and variable. An unknown part may be named by its label, if only one has it."""
    labels = [one.label for one in template.unknowns]
    unique = {one.label: one.home for one in template.unknowns if labels.count(one.label) == 1}
    by_option: dict[str, Mapping[str, tuple[str, ...]]] = {
        "--positive": dict.fromkeys(prior.positive, ("positive",)),
        "--monotone": prior.monotone,
        "--limit": prior.limits,
    }
    return {
        option: _texts(sides, option, {unique.get(side, side): texts for side, texts in by_side.items()})
        for option, by_side in by_option.items()
    }


def _check_shapes(
    shapes: Mapping[str, Mapping[str, tuple[str, ...]]], space: SpaceConfig, names: Sequence[str]
) -> None:
    """Refuse shapes that cannot be read, or that name a variable which their equation may not use."""
    for option, by_variable in shapes.items():
        for name, texts in by_variable.items():
            usable = [names[column] for column in space.columns_for(name, names)]
            read_shapes(texts, usable, f"{option} for '{name}'")


def _check_searched(
    by_option: Mapping[str, Mapping[str, object]], known: Mapping[str, str], given: Sequence[str],
    template: EquationTemplate,
) -> None:  # fmt: skip
    """Refuse options for equations that are not searched: `known` ones, and the `given` ones of a template."""
    for option, by_variable in by_option.items():
        for name in by_variable:
            if name in known:
                raise UsageError(f"{option} names '{name}', whose equation is known; leave one of the two out")
            if name in given:
                raise UsageError(f"{option} names '{name}', {_why_not_searched(template, name)}")


def _why_not_searched(template: EquationTemplate, equation: str) -> str:
    """Return why nothing is searched under the name of a given equation, as a clause, and what to do."""
    shared = next((unknown for unknown in template.unknowns if equation in unknown.equations), None)
    if shared is None:
        return "whose given equation has no unknown part; leave one of the two out, or add ? to the equation"
    return f"whose unknown part {shared.label} is searched for '{shared.home}'; name '{shared.home}' instead"


def _sides(config: JobConfig, variables: Sequence[str], symbols: Mapping[str, str]) -> LeftSides:
    return LeftSides(tuple(variables), symbols, None if config.data.target is not None else config.data.order)


def _texts(sides: LeftSides, option: str, by_side: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    return {name: tuple(chain.from_iterable(texts)) for name, texts in sides.several(option, by_side).items()}


def _resolved_bounds(
    bounds: Mapping[str, tuple[str, ...]], sides: LeftSides, sought: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return the bounds by variable, with the bounds on all equations.

    Raises UsageError, also if two bounds on the same number of an equation exclude every value.
    """
    general = tuple(bounds.get(ALL_EQUATIONS, ()))
    own = _texts(sides, "--bound", {side: texts for side, texts in bounds.items() if side != ALL_EQUATIONS})
    if general and not sought:
        raise UsageError(f"--bound {general[0]!r} restricts searched equations, but all are known; leave it out")
    names = tuple(sides.symbols.values())
    whole = {name: (*general, *own.get(name, ())) for name in dict.fromkeys((*sought, *own))}
    for name, texts in whole.items():
        try:
            parsed = [parse_bound(text, names) for text in texts]
        except UsageError as error:
            raise UsageError(f"--bound: {error}") from error
        for one, other in combinations(parsed, 2):
            is_of_same = (one.scope, one.shape) == (other.scope, other.shape) or "every" in (one.scope, other.scope)
            if is_of_same and not max(one.lower, other.lower) < min(one.upper, other.upper):
                pair = f"the bounds {one.text!r} and {other.text!r} of '{name}'"
                raise UsageError(f"--bound: {pair} contradict each other; leave one of them out")
    return {name: texts for name, texts in whole.items() if texts}


def _parsed(option: str, variable: str, text: str, names: Sequence[str]) -> Program:
    try:
        return from_infix(text, names)
    except UsageError as error:
        raise UsageError(f"{option} for '{variable}': {error}") from error


def _known_program(variable: str, text: str, names: Sequence[str]) -> Program:
    program = simplify_program(_parsed("--known", variable, text, names))
    if tree_size(program) > PRINTABLE_SIZE:
        raise UsageError(f"--known for '{variable}' has more than {PRINTABLE_SIZE} operations when written out")
    return program


def _check_guesses(config: JobConfig, variable: str, texts: Sequence[str], names: Sequence[str]) -> None:
    population = config.evolution.population
    most = population // _INDIVIDUALS_PER_GUESS
    if len(texts) > most:
        raise UsageError(
            f"--guess gives {len(texts)} guesses for '{variable}', but a population of {population} takes at most "
            f"{most}; leave the least likely ones out"
        )
    for text in texts:
        program = _parsed("--guess", variable, text, names)
        objection = _objection(config.space, variable, text, program, names)
        if objection is not None:
            raise UsageError(f"the guess '{text}' for '{variable}' {objection}")


def _objection(space: SpaceConfig, variable: str, text: str, program: Program, names: Sequence[str]) -> str | None:
    """Return why a guess cannot be in the populations of `variable`, as a clause without subject; None if it can."""
    columns = space.columns_for(variable, names)
    used = set(program.left[program.operators == VARIABLE].tolist())
    excluded = [names[index] for index in sorted(used.difference(columns))]
    if excluded:
        return f"uses {excluded[0]}, but --allow lets it use {', '.join(names[index] for index in columns)} only"
    operators = [BY_NAME[name].code for name in space.operators_for(variable)]
    try:
        placed_text(text, names, operators, space.terminals_for(len(names)), space.operator_nodes)
    except UsageError as error:
        return str(error)
    size = complexity(program)
    if space.max_size is not None and size > space.max_size:
        return f"has size {size}, but --max-size is {space.max_size}; shorten it, or allow more"
    return None
