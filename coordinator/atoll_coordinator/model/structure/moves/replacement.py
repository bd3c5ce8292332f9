"""Replace one node of a program with an expression. Every structural move uses this replacement."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Final

from atoll_core.expression.operators import ADD, COS, MULTIPLY, NEGATE, SIN, SUBTRACT
from atoll_core.expression.program import Expression, Node, Program, ProgramBuilder, operators_in, structure
from atoll_core.expression.writing.shortest import collected

FRESH_CONSTANT: Final = 1.5
"""Start value of a new constant in a fit. The simplification would remove a neutral value such as 1."""


def replace_node(nodes: list[Node], index: int, replacement: Expression) -> Program:
    """Return the program, as a sum of products, with node `index` replaced; see `replace_nodes`."""
    return replace_nodes(nodes, {index: replacement})


def replace_nodes(nodes: list[Node], replacements: Mapping[int, Expression]) -> Program:
    """Return the program, as a sum of products, with some nodes (by index) replaced.

    A replacement may refer to nodes up to its index, including the replaced node.
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
    """Yield, as sums of products, the programs in which one node is replaced by one of its `replacements`. Each
    structure is yielded once.

    Args:
        program: the program to be changed, which is not yielded.
        nodes: its nodes.
        operators: codes of the operators that a replacement may contain.
        replacements: returns the expressions that may replace the node of an index, see `replace_node`.
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

    The reasons are sin(u + pi/2) = cos u, sin(u + pi) = -sin u, and cos 2u = 2 cos^2 u - 1.
    """
    kind, *parts, _ = argument
    for part in parts:
        if kind in (ADD, SUBTRACT):
            for function in (SIN, COS):
                yield (function, part)
                yield (NEGATE, (function, part))
        if code == COS:
            yield (MULTIPLY, (COS, part), (COS, part))
