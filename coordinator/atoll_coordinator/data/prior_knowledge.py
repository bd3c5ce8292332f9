"""What is known beforehand, in terms of the data: guesses, known equations, what an equation may be made of. Pure.

What cannot be used is refused in one sentence, before anything is searched.
"""

from collections.abc import Mapping, Sequence
from itertools import chain, combinations, combinations_with_replacement
from typing import Final

from atoll_coordinator.data.recording import component_name
from atoll_coordinator.data.roles.left_hand_sides import LeftSides
from atoll_coordinator.data.roles.roles import Roles
from atoll_core.config import JobConfig, PriorConfig, SpaceConfig
from atoll_core.data.dataset import Dataset
from atoll_core.errors import UsageError
from atoll_core.expression.operation_list import placed_text
from atoll_core.expression.operators import BY_NAME, VARIABLE
from atoll_core.expression.program import Program
from atoll_core.expression.restrictions import ALL_EQUATIONS, ConstantBound, parse_bound
from atoll_core.expression.simplification import complexity, simplify_program
from atoll_core.expression.text.infix import PRINTABLE_SIZE, tree_size
from atoll_core.expression.text.parsing import from_infix

_INDIVIDUALS_PER_GUESS: Final = 4
"""At most one of so many individuals begins as a guess; more are refused."""


def resolve_equations(config: JobConfig, roles: Roles, symbols: Mapping[str, str]) -> tuple[JobConfig, tuple[str, ...]]:
    """Return the resolved configuration (see `resolve_prior`) and the equations of the job, in order.

    Those are the ones sought, all unless ``--only`` names some, and the known ones; of a stochastic process also every
    component of its diffusion, some of which the data may not show. Raises UsageError.
    """
    names = roles.equations
    if config.data.stochastic:
        names = (*names, *(component_name(*pair) for pair in combinations_with_replacement(roles.states, 2)))
    known = _sides(config, names, symbols).single("--known", config.prior.known)
    only = config.data.only
    equations = tuple(name for name in names if not only or name in only or name in known)
    return resolve_prior(config, equations, symbols), equations


def resolve_prior(config: JobConfig, variables: Sequence[str], symbols: Mapping[str, str]) -> JobConfig:
    """Return `config` with what is known beforehand by variable, and allowed variables by symbol; all is checked.

    Args:
        config: as submitted; one that has been through this stays as it is.
        variables: names of the job's equations, of known ones as well.
        symbols: symbol of each column that expressions may use, in the order of the dataset's rows.

    Raises:
        UsageError: a left-hand side, name or operator does not exist or is given twice, an expression cannot be read,
            or a guess does not fit the operation lists of its equation.
    """
    sides, names = _sides(config, variables, symbols), tuple(symbols.values())
    known = sides.single("--known", config.prior.known)
    for name, text in known.items():
        _known_program(name, text, names)
    guesses = _texts(sides, "--guess", config.prior.guesses)
    space = _resolved_space(config.space, sides)
    bounds = _resolved_bounds(config.prior.bounds, sides, [name for name in variables if name not in known])
    for option, by_variable in (
        ("--guess", guesses),
        ("--operators", space.operators_of),
        ("--allow", space.variables_of),
        ("--require", space.required_of),
        ("--bound", bounds),
    ):
        for name in by_variable:
            if name in known:
                raise UsageError(f"{option} names '{name}', whose equation is known; leave one of the two out")
    _check_required(space, names)
    prior = PriorConfig(guesses=guesses, known=known, bounds=bounds)
    resolved = config.model_copy(update={"prior": prior, "space": space})
    for name, texts in guesses.items():
        _check_guesses(resolved, name, texts, names)
    return resolved


def _texts(sides: LeftSides, option: str, by_side: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Return the texts by variable; raises UsageError."""
    return {name: tuple(chain.from_iterable(texts)) for name, texts in sides.several(option, by_side).items()}


def _resolved_bounds(
    bounds: Mapping[str, tuple[str, ...]], sides: LeftSides, sought: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return the bounds by variable, those on all equations among them; raises UsageError."""
    general = tuple(bounds.get(ALL_EQUATIONS, ()))
    own = _texts(sides, "--bound", {side: texts for side, texts in bounds.items() if side != ALL_EQUATIONS})
    if general and not sought:
        raise UsageError(f"--bound {general[0]!r} is about equations that are sought, but all are known; leave it out")
    names = tuple(sides.symbols.values())
    whole = {name: (*general, *own.get(name, ())) for name in dict.fromkeys((*sought, *own))}
    for name, texts in whole.items():
        try:
            _check_agreement(name, [parse_bound(text, names) for text in texts])
        except UsageError as error:
            raise UsageError(f"--bound: {error}") from error
    return {name: texts for name, texts in whole.items() if texts}


def _check_agreement(name: str, bounds: Sequence[ConstantBound]) -> None:
    """Raise UsageError where two bounds on the same numbers of an equation leave none of them."""
    for one, other in combinations(bounds, 2):
        is_of_same = (one.scope, one.shape) == (other.scope, other.shape) or "every" in (one.scope, other.scope)
        if is_of_same and not max(one.lower, other.lower) < min(one.upper, other.upper):
            pair = f"the bounds {one.text!r} and {other.text!r} of '{name}'"
            raise UsageError(f"{pair} contradict each other; leave one of them out")


def _check_required(space: SpaceConfig, names: Sequence[str]) -> None:
    """Raise UsageError where an equation must have a variable that it may not use."""
    for variable, required in space.required_of.items():
        allowed = [names[column] for column in space.columns_for(variable, names)]
        excluded = next((name for name in required if name not in allowed), None)
        if excluded is not None:
            raise UsageError(
                f"--require wants {excluded} in the equation of '{variable}', but --allow lets it use "
                f"{', '.join(allowed)} only; change one of the two"
            )


def known_programs(dataset: Dataset, config: JobConfig) -> dict[str, Program]:
    """Return the programs of the known equations by variable, in the order of the dataset, which has them as targets.

    `config` is resolved. Raises UsageError where an equation is no expression over the dataset's symbols.
    """
    known = config.prior.known
    return {name: _known_program(name, known[name], dataset.names) for name in dataset.variables if name in known}


def guessed_programs(dataset: Dataset, config: JobConfig) -> dict[str, tuple[Program, ...]]:
    """Return the programs of the guesses by variable, their constants as given.

    `config` is resolved. Raises UsageError where a guess is no expression over the dataset's symbols.
    """
    guesses = config.prior.guesses
    return {
        name: tuple(simplify_program(_parsed("--guess", name, text, dataset.names)) for text in guesses[name])
        for name in dataset.variables
        if name in guesses
    }


def _sides(config: JobConfig, variables: Sequence[str], symbols: Mapping[str, str]) -> LeftSides:
    return LeftSides(tuple(variables), symbols, None if config.data.target is not None else config.data.order)


def _resolved_space(space: SpaceConfig, sides: LeftSides) -> SpaceConfig:
    allowed = sides.single("--allow", space.variables_of)
    required = sides.single("--require", space.required_of)
    update = {
        "operators_of": sides.single("--operators", space.operators_of),
        "required_of": {name: sides.symbols_of("--require", texts) for name, texts in required.items()},
        "variables_of": {name: sides.symbols_of("--allow", texts) for name, texts in allowed.items()},
    }
    return space.model_copy(update=update)


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
    """Raise UsageError unless every guess for `variable` can stand in its populations."""
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
    """Return why a guess cannot stand in the populations of `variable`, without its subject; None when it can."""
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
