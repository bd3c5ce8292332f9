"""Slow, obvious versions of variation and selection, by sets and Python's own lists."""

from collections.abc import Sequence
from dataclasses import dataclass

from atoll_core.expression.operators import ARITY, CONSTANT, VARIABLE
from atoll_core.search.seeding import Stream
from atoll_island_worker.evolution.structures import Lists, Space

Node = tuple[int, int, int, float]


def nodes_of(lists: Lists, p: int) -> list[Node]:
    """Return list `p` as (code, left, right, constant)."""
    columns = (lists.code[p], lists.left[p], lists.right[p], lists.constants[p])
    return list(zip(*(column.tolist() for column in columns), strict=True))


def problems(lists: Lists, p: int, space: Space) -> list[str]:
    """Return what list `p` has that no list of `space` may have; empty for a sound one."""
    places = []
    for i, (code, left, right, _) in enumerate(nodes_of(lists, p)):
        if i < space.terminals:
            limit = space.variables if code == VARIABLE else 1
            sound = code in (VARIABLE, CONSTANT) and 0 <= left < limit and right == 0
        else:
            sound = code in space.operators.tolist() and 0 <= left < i and 0 <= right < i
        if not sound:
            places.append(f"node {i}: {code} {left} {right}")
    return places


def live_of(nodes: Sequence[Node]) -> set[int]:
    """Return the nodes that the last one depends on, itself included."""
    live, waiting = set(), [len(nodes) - 1]
    while waiting:
        node = waiting.pop()
        if node not in live:
            live.add(node)
            code, left, right, _ = nodes[node]
            waiting += [left, right][: ARITY[code]]
    return live


def distance(one: Sequence[Node], two: Sequence[Node]) -> int:
    """Return how many nodes, live in either list, differ in what they compute; the values of constants do not count."""

    def seen(nodes: Sequence[Node]) -> list[tuple[int, ...] | None]:
        live = live_of(nodes)
        return [meaning(node) if i in live else None for i, node in enumerate(nodes)]

    return sum(a != b for a, b in zip(seen(one), seen(two), strict=True))


def is_same(one: Sequence[Node], two: Sequence[Node]) -> bool:
    """Return whether two lists compute the same: the same live nodes, with the same constants."""
    return distance(one, two) == 0 and all(one[i][3] == two[i][3] for i in live_of(one) if one[i][0] == CONSTANT)


def meaning(node: Node) -> tuple[int, ...]:
    """Return operator and arguments of a node, the value of a constant left out."""
    code, left, right, _ = node
    if code == CONSTANT:
        return (code,)
    return (code, left, right)[: 1 + max(1, ARITY[code])]


def crossed(first: Sequence[Node], second: Sequence[Node], cut: int) -> tuple[list[Node], list[Node]]:
    """Return the complementary children of two lists cut before node `cut`."""
    return [*first[:cut], *second[cut:]], [*second[:cut], *first[cut:]]


@dataclass
class Member:
    """One individual of a population."""

    nodes: list[Node]
    fitness: float


def survivors(parents: tuple[Member, Member], children: tuple[Member, Member]) -> tuple[Member, Member]:
    """Return who has the two places after deterministic crowding: a child no worse than the parent it resembles.

    The children are paired with the parents so that the distances add up to less; a tie goes uncrossed.
    """
    one, two = parents
    straight = distance(one.nodes, children[0].nodes) + distance(two.nodes, children[1].nodes)
    across = distance(one.nodes, children[1].nodes) + distance(two.nodes, children[0].nodes)
    rivals = children if straight <= across else children[::-1]
    winners = [
        child if child.fitness <= parent.fitness else parent for parent, child in zip(parents, rivals, strict=True)
    ]
    return winners[0], winners[1]


def cut_of(stream: Stream, space: Space) -> int:
    """Return the place of the cut that `stream` draws, the list's end when there is no crossover."""
    return 1 + stream.below(space.nodes - 1) if stream.uniform() < space.crossover else space.nodes
