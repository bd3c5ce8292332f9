"""One node of a program replaced by an expression, which every structural move does."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Final

from atoll_core.expression.operators import ADD, COS, MULTIPLY, NEGATE, SIN, SUBTRACT
from atoll_core.expression.program import Expression, Node, Program, ProgramBuilder, operators_in, structure
from atoll_core.expression.writing.shortest import collected

FRESH_CONSTANT: Final = 1.5
"""Where the fit of a constant begins that has no old value: a neutral one would not stay."""


def replace_node(nodes: list[Node], index: int, replacement: Expression) -> Program:
    """Return the program, as a sum of products, in which `replacement` stands for node `index`, see `replace_nodes`."""
    return replace_nodes(nodes, {index: replacement})


def replace_nodes(nodes: list[Node], replacements: Mapping[int, Expression]) -> Program:
    """Return the program, as a sum of products, in which others stand for some nodes (by index).

    Nodes in a replacement are those up to its index, the old one included.
    """
    builder = ProgramBuilder()
    places: list[int] = []
    for index in sorted(replacements):
        places = builder.copy(nodes[len(places) : index + 1], places)
        places[index] = builder.build(replacements[index], places)
    return collected(builder.program(builder.copy(nodes[len(places) :], places)[-1]))


def replace_each(
    program: Program, nodes: list[Node], operators: Collection[int], replacements: Callable[[int], Iterable[Expression]]
) -> Iterator[Program]:
    """Yield the programs in which one node gives way to one of its `replacements`, collected; each structure once.

    Args:
        program: the one to be changed, which is not yielded itself.
        nodes: its nodes.
        operators: codes; nothing else is brought in.
        replacements: by the index of a node, the expressions that may replace it, see `replace_node`.
    """
    known = {structure(program)}
    for index in range(len(nodes)):
        for replacement in replacements(index):
            if any(code not in operators for code in operators_in(replacement)):
                continue
            changed = replace_node(nodes, index, replacement)
            if structure(changed) not in known:
                known.add(structure(changed))
                yield changed


def cofunctions(code: int, argument: Node) -> Iterator[Expression]:
    """Yield replacements of the sine or cosine of a sum or a product: its cofunction, its negative, or a square.

    For sin(u + pi/2) = cos u, sin(u + pi) = -sin u, and cos 2u = 2 cos^2 u - 1.
    """
    kind, *parts, _ = argument
    for part in parts:
        if kind in (ADD, SUBTRACT):
            for function in (SIN, COS):
                yield (function, part)
                yield (NEGATE, (function, part))
        if code == COS:
            yield (MULTIPLY, (COS, part), (COS, part))
