"""A program: one expression as a list of operations. Fronts hold programs, and messages carry them.

Each node refers to earlier nodes only, so a program is an acyclic graph that can always be evaluated. The last node is
the output. In a `Program` the output depends on every node. The lists of the search, which also have unused nodes, are
in `atoll_island_worker.evolution`. `ProgramBuilder` makes programs node by node. All operators are added by its method
`operate`; a subclass may override this method to simplify the program.
"""

import struct
from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from atoll_core.errors import RemoteProtocolError
from atoll_core.expression.operators import ADD, ARITY, CONSTANT, MULTIPLY, OPERATORS, VARIABLE

MAX_NODES = 240

Node = tuple[int, int, int, float]
"""Four numbers: the code of the operator, its two arguments, and the value of a constant. For a variable, the first
argument is the variable's index; a missing argument is 0."""


@dataclass(frozen=True, eq=False)
class Program:
    """Operation list of N nodes.

    `operators`: (N,) int8 codes. `left`, `right`: (N,) int16; for VARIABLE, `left` is the index of the input variable.
    For CONSTANT, both are 0. For operators, they are indices of earlier nodes (`right` is 0 for a unary operator).
    `constants`: (N,) float64, the values of CONSTANT nodes, and 0.0 for other nodes.
    """

    operators: npt.NDArray[np.int8]
    left: npt.NDArray[np.int16]
    right: npt.NDArray[np.int16]
    constants: npt.NDArray[np.float64]

    @classmethod
    def of(cls, nodes: Iterable[Node]) -> "Program":
        """Return the program of these nodes; there must be at least one node."""
        codes, lefts, rights, values = zip(*nodes, strict=True)
        return cls(np.array(codes, np.int8), np.array(lefts, np.int16), np.array(rights, np.int16), np.array(values))

    def nodes(self) -> list[Node]:
        """Return the nodes; the last node is the output."""
        columns = (self.operators, self.left, self.right, self.constants)
        return list(zip(*(column.tolist() for column in columns), strict=True))

    def __len__(self) -> int:
        return len(self.operators)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Program) and self.to_bytes() == other.to_bytes()

    def __hash__(self) -> int:
        return hash(self.to_bytes())

    def to_bytes(self) -> bytes:
        """Return the canonical bytes: count, codes, left, right (little endian), then the constants in node order."""
        live = self.constants[self.operators == CONSTANT]
        columns = (self.operators.astype("<i1"), self.left.astype("<i2"), self.right.astype("<i2"), live.astype("<f8"))
        return struct.pack("<B", len(self)) + b"".join(column.tobytes() for column in columns)

    @classmethod
    def from_bytes(cls, data: bytes, variables: int) -> "Program":
        """Parse and check canonical bytes of a program over `variables` inputs; raises RemoteProtocolError."""
        check_program_bytes(data, variables)
        count = data[0]
        operators = np.frombuffer(data, "<i1", count, 1).astype(np.int8)
        left = np.frombuffer(data, "<i2", count, 1 + count).astype(np.int16)
        right = np.frombuffer(data, "<i2", count, 1 + 3 * count).astype(np.int16)
        constants = np.zeros(count)
        constants[operators == CONSTANT] = np.frombuffer(data, "<f8", -1, 1 + 5 * count)
        return cls(operators, left, right, constants)


def constant_places(program: Program) -> list[int]:
    """Return the indices of the constants of `program`."""
    return np.flatnonzero(program.operators == np.int8(CONSTANT)).tolist()


def variables_of(program: Program) -> set[int]:
    """Return the variables of `program`, as indices of the inputs."""
    return set(program.left[program.operators == np.int8(VARIABLE)].tolist())


def with_constants(program: Program, values: Mapping[int, float]) -> Program:
    """Return `program` with other values of the constants at these indices."""
    constants = program.constants.copy()
    for place, value in values.items():
        constants[place] = value
    return Program(program.operators, program.left, program.right, constants)


def dependent_nodes(nodes: Sequence[Node], leaves: Collection[int]) -> list[bool]:
    """Return, for each node, whether it depends on one of the `leaves` (variables and constants)."""
    depends: list[bool] = []
    for index, (code, left, right, _) in enumerate(nodes):
        is_leaf = not ARITY[code]
        depends.append(index in leaves if is_leaf else depends[left] or (ARITY[code] == 2 and depends[right]))
    return depends


def moved(node: Node, place: Mapping[int, int]) -> Node:
    """Return a node with its arguments renumbered."""
    code, left, right, value = node
    if not ARITY[code]:
        return node
    return code, place[left], place[right] if ARITY[code] == 2 else 0, value


def structure(program: Program) -> bytes:
    """Return a key of a program without the values of its constants. Programs that differ only in these values have
    equal keys."""
    return program.operators.tobytes() + program.left.tobytes() + program.right.tobytes()


def check_program_bytes(data: bytes, variables: int) -> None:
    """Check canonical bytes as `Program.from_bytes` does, but without making a program, in a tenth of the time.

    Raises:
        RemoteProtocolError: they are not a program over `variables` inputs.
    """
    count = data[0] if data else 0
    if not 1 <= count <= MAX_NODES or len(data) < 1 + 5 * count:
        raise RemoteProtocolError(f"a program of {len(data)} bytes claims {count} nodes, which does not fit")
    codes, *nodes = struct.unpack_from(f"<{count}s{2 * count}h", data, 1)
    if len(data) != 1 + 5 * count + 8 * codes.count(CONSTANT):
        raise RemoteProtocolError(f"a program of {count} nodes has {len(data)} bytes, which does not fit")
    known = len(OPERATORS)
    for index, (code, left, right) in enumerate(zip(codes, nodes[:count], nodes[count:], strict=True)):
        if code >= known:
            raise RemoteProtocolError(f"node {index} of a program has unknown operator code {code}")
        arity = ARITY[code]
        if arity == 2:
            fits = 0 <= left < index and 0 <= right < index
        else:
            fits = right == 0 and 0 <= left < (index if arity else variables if code == VARIABLE else 1)
        if not fits:
            raise RemoteProtocolError(f"node {index} of a program refers to {left}, {right}, which do not exist")


Expression: TypeAlias = "int | float | tuple[Expression, ...]"
"""An expression from which nodes are built. It is the index of a node (int), a constant (float), ``(VARIABLE, index)``,
or the code of an operator followed by its arguments, which are expressions themselves."""


class ProgramBuilder:
    """The nodes of a program under construction."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._places: dict[Hashable, int] = {}

    def add(self, code: int, left: int = 0, right: int = 0, value: float = 0.0) -> int:
        """Return the index of a node. If an earlier node is equal (see `key`), return the index of the earlier node."""
        key = self.key(code, left, right, value)
        if key not in self._places:
            self._places[key] = self.append(code, left, right, value)
        return self._places[key]

    def key(self, code: int, left: int, right: int, value: float) -> Hashable:
        """Return a key that is the same for equal nodes. Two constants are equal if all their bits are equal."""
        return code, left, right, value.hex()

    def append(self, code: int, left: int = 0, right: int = 0, value: float = 0.0) -> int:
        """Return the index of a new node that is not merged with equal nodes: constants can be fitted separately."""
        self.nodes.append((code, left, right, value))
        return len(self.nodes) - 1

    def constant(self, value: float) -> int:
        """Return the index of a constant."""
        return self.add(CONSTANT, value=value)

    def operate(self, code: int, left: int, right: int = 0) -> int:
        """Return the index of an operator on earlier nodes; `right` is 0 for a unary operator."""
        return self.add(code, left, right)

    def copy(self, nodes: Iterable[Node], places: Sequence[int] = (), *, merges_constants: bool = True) -> list[int]:
        """Append nodes of another list, and return the new places of all nodes of this list. Its first nodes are
        already at `places`."""
        new = list(places)
        for code, left, right, value in nodes:
            if ARITY[code]:
                new.append(self.operate(code, new[left], new[right] if ARITY[code] == 2 else 0))
            elif code == CONSTANT and not merges_constants:
                new.append(self.append(CONSTANT, value=value))
            else:
                new.append(self.add(code, left, right, value))
        return new

    def build(self, expression: Expression, places: Sequence[int] | None = None) -> int:
        """Add an expression and return the index of its node. If `places` are given, node indices in the expression
        refer to another list, whose nodes are at `places`."""
        if isinstance(expression, int):
            return expression if places is None else places[expression]
        if isinstance(expression, float):
            return self.constant(expression)
        code, *arguments = expression
        assert isinstance(code, int)
        if code == VARIABLE:
            assert isinstance(arguments[0], int)
            return self.add(VARIABLE, arguments[0])
        return self.operate(code, *(self.build(argument, places) for argument in arguments))

    def program(self, output: int) -> Program:
        """Return the program of a node: the nodes on which it depends, in their order."""
        return Program.of(live_nodes(self.nodes, output))


def live_nodes(nodes: Sequence[Node], output: int) -> list[Node]:
    """Return the nodes on which `output` depends, in their order, renumbered."""
    needed = {output}
    for index in range(output, -1, -1):
        if index in needed:
            code, left, right, _ = nodes[index]
            needed.update((left, right)[: ARITY[code]])
    place = {old: new for new, old in enumerate(sorted(needed))}
    return [moved(nodes[old], place) for old in place]


def operators_in(expression: Expression) -> Iterator[int]:
    """Yield the codes of the operators of an expression."""
    if isinstance(expression, tuple):
        code, *arguments = expression
        assert isinstance(code, int)
        if ARITY[code]:
            yield code
            for argument in arguments:
                yield from operators_in(argument)


def tree_size(program: Program) -> int:
    """Return the number of nodes of `program` if it is printed as a tree. In a*a and a + a, the two operands count as
    one."""
    sizes: list[int] = []
    for code, left, right, _ in program.nodes():
        size = 1
        if ARITY[code]:
            size += sizes[left]
        if ARITY[code] == 2 and (left != right or code not in (ADD, MULTIPLY)):
            size += sizes[right]
        sizes.append(size)
    return sizes[-1]
