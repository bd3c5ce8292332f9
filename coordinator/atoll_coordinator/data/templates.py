"""The template of a job: the given equations of its configuration, over the symbols of its dataset; and whether a job
can have them. Pure."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from atoll_coordinator.data.roles.names_and_options import check_given_equations
from atoll_coordinator.data.roles.roles import RESERVED, Roles, assign_symbols
from atoll_core.config import JobConfig, ParameterConfig
from atoll_core.errors import UsageError
from atoll_core.expression import operators as op
from atoll_core.expression.program import Program, tree_size
from atoll_core.expression.template import Parameter, Template, Unknown, read_template
from atoll_core.expression.text.infix import PRINTABLE_SIZE

_UNDECIDED: Final = {op.SIN: "sin", op.COS: "cos", op.ABS: "abs", op.SQUARE: "a power"}
"""Operations with the same value for several arguments, so that the value does not determine an unknown inside."""


def template_of(config: JobConfig, names: Sequence[str]) -> Template | None:
    """Return the template over the symbols `names`; None if no equation is given with ``--equation``.

    `config` is resolved: its equations are keyed by variable.

    Raises:
        UsageError: see `read_template`.
    """
    prior = config.prior
    if not prior.equations and not prior.parameters:
        return None
    return read_template(prior.equations, parameters_of(prior.parameters), names)


def parameters_of(given: Mapping[str, ParameterConfig]) -> dict[str, Parameter]:
    """Return the parameters of a configuration, by name."""
    return {
        name: Parameter(
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


def check_template(template: Template) -> None:
    """Raise UsageError for names that no parameter may have, and for unknown parts that the data cannot determine."""
    reserved = next((one.name for one in template.parameters if one.name in RESERVED), None)
    if reserved is not None:
        raise UsageError(f"--equation uses {reserved}, the name of a function, as a parameter; choose another name")
    first = len(template.names) + len(template.parameters)
    for equation, side in template.sides.items():
        if tree_size(side) > PRINTABLE_SIZE:
            raise UsageError(f"--equation for '{equation}' has more than {PRINTABLE_SIZE} operations when written out")
        for place, unknown in enumerate(template.unknowns):
            _check_unknown(side, first + place, unknown, equation)


def _check_unknown(side: Program, variable: int, unknown: Unknown, equation: str) -> None:
    """Raise UsageError if the value of a side does not determine the value of an unknown in it.

    `linear` and `other` are the nodes that depend linearly and otherwise on the unknown.
    """
    linear, other, label = set[int](), set[int](), unknown.label
    for node, (code, left, right, _) in enumerate(side.nodes()):
        if code in (op.CONSTANT, op.VARIABLE):
            linear |= {node} if code == op.VARIABLE and left == variable else set()
            continue
        arguments = [left, right][: op.OPERATORS[code].arity]
        dependent = [argument for argument in arguments if argument in linear or argument in other]
        if not dependent:
            continue
        if code in _UNDECIDED or (code == op.POW and dependent[0] == left):
            inside = _UNDECIDED.get(code, "a power")
            raise UsageError(
                f"--equation for '{equation}' has {label} inside {inside}, whose value does not determine {label}; "
                f"write {label} for the whole of it"
            )
        is_sum = code in (op.ADD, op.SUBTRACT)
        if len(dependent) > 1 and not (is_sum and linear.issuperset(dependent)):
            raise UsageError(
                f"--equation for '{equation}' has {label} in both parts of a sum, product, quotient or power, whose "
                f"value does not determine {label}; write {label} once"
            )
        keeps = code in (op.ADD, op.SUBTRACT, op.NEGATE, op.MULTIPLY) or (code == op.DIVIDE and dependent == [left])
        (linear if keeps and linear.issuperset(dependent) else other).add(node)
