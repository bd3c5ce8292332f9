"""How short are the equations that are shown? Counted as a reader does, beside the paper's own writing.

``python -m benchmarks.judging.writings --seeds 100-109`` searches the 14 equations of Table III (derivatives estimated)
and compares what is shown with the paper's equation: nodes, parts that cancel, quarter turns inside a sine or cosine.
``--results FILE…`` does so for saved files instead: ``result.json``, or the lines of ``benchmarks.noise --out``; where
the system cannot be told from its states, only the latter two. ``--dresses N`` searches nothing: it writes known laws
in N other ways by valid identities, drawn from seeds, and reports how often the shortest writing comes back.

A node is a number, a variable, an operator or a function; a minus sign in front and brackets are none.
"""

import json
import math
import re
import statistics
import sys
import time
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll.terminal.output import clipped, note, say, table
from atoll_core.expression.builder import Expression, ProgramBuilder
from atoll_core.expression.operators import (
    ADD,
    CONSTANT,
    COS,
    DIVIDE,
    MULTIPLY,
    NEGATE,
    SIN,
    SQUARE,
    SUBTRACT,
    VARIABLE,
)
from atoll_core.expression.program import Program
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing.shortest import shortest
from benchmarks.harness.command_line import option, program, search_options, whole
from benchmarks.harness.jobs import configured
from benchmarks.harness.record import Record
from benchmarks.harness.service import searching
from benchmarks.harness.systems import TABLE_III, TRUTH, table_of
from benchmarks.harness.tables import grouped
from benchmarks.paper.seven import case

_TOKEN: Final = re.compile(r"[^\W\d]\w*|\d+\.?\d*(?:[eE][-+]?\d+)?|\*\*|[-+*/()]")
_QUARTER: Final = re.compile(r"(?:sin|cos)\([^()]*\b(?:1\.5707\d*|3\.1415\d*|4\.7123\d*|6\.2831\d*)")

LAWS: Final = (
    *((text, tuple(TRUTH[system])) for system in TABLE_III for text in TRUTH[system].values()),
    ("0.79*x*(1 - x/74.3)", ("x",)),
    ("-0.1*w - sin(a)", ("a", "w")),
    ("x*(28 - z) - y", ("x", "y", "z")),
    ("1.4*x/(0.3 + x) - 0.2*x", ("x",)),
    ("x - x**3/3 - y + 0.5", ("x", "y")),
    ("0.3*exp(-y)*x - 0.7*y", ("x", "y")),
    ("2*x*log(y) - sqrt(x)", ("x", "y")),
    ("sin(a - b) + 0.4*cos(a)**2", ("a", "b")),
)
"""Laws and their variables: the paper's, and some of textbooks."""


@dataclass(frozen=True)
class Writing:
    """One equation as shown. `paper` are the nodes of the paper's writing, None where that is unknown."""

    system: str
    variable: str
    seed: int | None
    expression: str
    nodes: int
    shortest: int
    paper: int | None
    has_quarter_turn: bool

    @property
    def is_short(self) -> bool:
        """Whether nothing cancels, no phase is a quarter turn, and the paper's writing is no shorter."""
        within = self.paper is None or self.nodes <= self.paper
        return within and self.nodes <= self.shortest and not self.has_quarter_turn


def count_nodes(text: str) -> int:
    """Return how many numbers, variables, operators and functions a text has; signs in front are none."""
    count, is_value_next = 0, True
    for token in _TOKEN.findall(text):
        if token == ")":
            is_value_next = False
        elif token != "(" and not (token in "+-" and is_value_next):
            count += 1
            is_value_next = token in ("+", "-", "*", "/", "**")
        elif token == "(":
            is_value_next = True
    return count


def measured(system: str, variable: str, seed: int | None, expression: str, names: Sequence[str]) -> Writing:
    """Return what is counted of one equation over `names`; `system` may be unknown, and is empty then."""
    best = to_infix(shortest(from_infix(expression, names)), names)
    truth = TRUTH.get(system, {}).get(variable)
    return Writing(
        system,
        variable,
        seed,
        expression,
        count_nodes(expression),
        count_nodes(best),
        None if truth is None else count_nodes(truth),
        _QUARTER.search(expression) is not None,
    )


def of_result(result: dict[str, Any], system: str = "", seed: int | None = None) -> Iterator[Writing]:
    """Yield what is counted of each equation of a ``result.json``; the system, unless given, is that of its states."""
    variables = [each["variable"] for each in result["equations"]]
    known = [name for name in TABLE_III if list(TRUTH[name]) == variables]
    names = list(dict.fromkeys([*result["symbols"].values(), *variables]))
    for equation in result["equations"]:
        if equation["expression"] is not None:
            its = system or (known[0] if len(known) == 1 else "")
            yield measured(its, equation["variable"], seed, equation["expression"], names)


def read(path: Path) -> Iterator[Writing]:
    """Yield what is counted of the equations in a file, see the module."""
    for line in [path.read_text()] if path.suffix == ".json" else path.read_text().splitlines():
        saved = json.loads(line)
        if "equations" in saved:
            yield from of_result(saved)
        elif saved.get("answer"):
            key = saved["outcome"]["key"]
            is_plain = key["variant"] != "odd"
            yield from of_result(saved["answer"], key["system"] if is_plain else "", key["seed"])


def searched(options: Namespace, record: Record) -> Iterator[Writing]:
    """Search every system with every seed and yield what is counted."""
    with searching(options.workers) as searches:
        for system in TABLE_III:
            for seed in options.seeds:
                sampled = case(system, options.step, seed)
                config = configured(seed, {"order": sampled.order}, {"max_time": options.max_time})
                result = searches.solve(f"{system} seed {seed}", table_of(sampled.sampled), config)
                note(
                    f"{system} seed {seed}: "
                    + "; ".join(str(equation["expression"]) for equation in result["equations"])
                )
                yield from of_result(result, system, seed)


# --------------------------------------------------------------------------------------------------- other dresses


def dressed(program: Program, draw: np.random.Generator, steps: int) -> Program:
    """Return another writing of the same function, made by `steps` valid identities at nodes that are drawn."""
    for _ in range(steps):
        nodes = program.nodes()
        index = int(draw.integers(len(nodes)))
        builder = ProgramBuilder()
        places = builder.copy(nodes[: index + 1])
        written = _other_writings(index, nodes, [(VARIABLE, int(draw.integers(1 + _last_variable(nodes))))])
        places[index] = builder.build(written[int(draw.integers(len(written)))], places)
        program = builder.program(builder.copy(nodes[index + 1 :], places)[-1])
    return program


def _last_variable(nodes: Sequence[tuple[int, int, int, float]]) -> int:
    return max((left for code, left, _, _ in nodes if code == VARIABLE), default=0)


def _other_writings(
    u: int, nodes: Sequence[tuple[int, int, int, float]], others: Sequence[Expression]
) -> list[Expression]:
    """Return expressions equal to node `u`, with one of the `others` in them."""
    (v,) = others
    code, left, right, value = nodes[u]
    quarter = math.pi / 2
    square_sum: Expression = (ADD, (SQUARE, (SIN, v)), (SQUARE, (COS, v)))
    found: list[Expression] = [
        (SUBTRACT, (ADD, u, v), v),
        (DIVIDE, (MULTIPLY, u, v), v),
        (ADD, (SUBTRACT, u, 0.75), 0.75),
        (SUBTRACT, (MULTIPLY, 2.0, u), u),
        (NEGATE, (NEGATE, u)),
        (MULTIPLY, u, square_sum),
        (DIVIDE, u, (DIVIDE, v, v)),
    ]
    if code == CONSTANT:
        found += [(MULTIPLY, 0.5 * value, 2.0), (SUBTRACT, value + 3.0, 3.0)]
    if code == SIN:
        found += [(COS, (SUBTRACT, left, quarter)), (NEGATE, (SIN, (NEGATE, left))), (SIN, (SUBTRACT, math.pi, left))]
    if code == COS:
        found += [(SIN, (ADD, left, quarter)), (COS, (NEGATE, left)), (NEGATE, (COS, (ADD, left, math.pi)))]
    if code == ADD:
        found += [(ADD, right, left), (SUBTRACT, left, (NEGATE, right))]
    if code == SUBTRACT:
        found += [(NEGATE, (SUBTRACT, right, left)), (ADD, left, (MULTIPLY, -1.0, right))]
    if code == MULTIPLY:
        found += [(MULTIPLY, right, left), *_distributed(nodes, left, right), *_distributed(nodes, right, left)]
    if code == DIVIDE:
        found += [(MULTIPLY, left, (DIVIDE, 1.0, right)), (DIVIDE, (MULTIPLY, left, v), (MULTIPLY, v, right))]
    return found


def _distributed(nodes: Sequence[tuple[int, int, int, float]], factor: int, its: int) -> list[Expression]:
    code, left, right, _ = nodes[its]
    return [(code, (MULTIPLY, factor, left), (MULTIPLY, factor, right))] if code in (ADD, SUBTRACT) else []


@dataclass(frozen=True)
class Dressing:
    """One law in another dress, and what the shortest writing of that is; `excess` are nodes more than it needs."""

    law: str
    dress: str
    found: str
    excess: int
    seconds: float


def undressed(law: str, names: Sequence[str], seed: int, steps: int) -> Dressing:
    """Dress a law and write it shortest again."""
    program = from_infix(law, names)
    dress = dressed(program, np.random.default_rng(seed), steps)
    begun = time.process_time()
    found = to_infix(shortest(dress), names)
    seconds = time.process_time() - begun
    least = count_nodes(to_infix(shortest(program), names))
    return Dressing(law, to_infix(dress, names), found, count_nodes(found) - least, seconds)


# ----------------------------------------------------------------------------------------------------- the tables


def _show(writings: Sequence[Writing]) -> None:
    rows = [
        (
            system or "?",
            variable,
            "-" if shown[0].paper is None else str(shown[0].paper),
            "-".join(str(limit) for limit in sorted({min(e.nodes for e in shown), max(e.nodes for e in shown)})),
            f"{sum(each.is_short for each in shown)} of {len(shown)}",
            clipped(max(shown, key=lambda each: each.nodes).expression, 80),
        )
        for (system, variable), shown in grouped(writings, lambda each: (each.system, each.variable)).items()
    ]
    say(table(("system", "variable", "paper's nodes", "shown", "short", "the longest"), rows))
    judged = [each for each in writings if each.paper is not None]
    for count, of, what in (
        (
            sum(each.nodes <= (each.paper or 0) for each in judged),
            judged,
            "at most as many nodes as the paper's writing",
        ),
        (sum(each.nodes > each.shortest for each in writings), writings, "a shorter writing"),
        (sum(each.has_quarter_turn for each in writings), writings, "a quarter turn inside a sine or cosine"),
    ):
        say(f"{count} of {len(of)} have {what}")


def _show_dresses(found: Sequence[Dressing], worst: int = 8) -> None:
    short = sum(each.excess <= 0 for each in found)
    ms = sorted(1e3 * each.seconds for each in found)
    times = f"median {statistics.median(ms):.1f} ms, 95 % in {ms[len(ms) * 95 // 100]:.0f} ms, longest {ms[-1]:.0f} ms"
    say(f"{short} of {len(found)} dresses come back to the shortest writing; {times}")
    for each in sorted(found, key=lambda each: -each.excess)[:worst]:
        if each.excess > 0:
            say(f"{each.law}: {each.excess} nodes too many: {each.found}\n    {clipped(each.dress, 200)}")


@program(
    "benchmarks.judging.writings",
    __doc__,
    option("--results", type=Path, nargs="+", metavar="FILE", help="saved results; nothing is searched"),
    option("--dresses", type=whole, metavar="N", help="other writings of each law; nothing is searched"),
    option("--step", type=float, default=0.02, help="sampling step (%(default)s; the paper's is 0.1)"),
    *search_options("100-109", 120.0),
)
def main(options: Namespace) -> int:
    """Measure, print the tables; return 0 when at least 95 % are short, else 1."""
    record = Record("writings", options.words, options.out)
    if options.dresses:
        found = [
            undressed(law, names, 1000 * number + seed, 1 + seed % 4)
            for number, (law, names) in enumerate(LAWS)
            for seed in range(options.dresses)
        ]
        _show_dresses(found)
        record.write(dresses=[asdict(each) for each in found])
        return 0 if sum(each.excess <= 0 for each in found) >= 0.95 * len(found) else 1
    if options.results:
        writings = [each for path in options.results for each in read(path)]
    else:
        writings = list(searched(options, record))
    _show(writings)
    record.write(writings=[asdict(writing) for writing in writings])
    return 0 if sum(each.is_short for each in writings) >= 0.95 * len(writings) else 1


if __name__ == "__main__":
    sys.exit(main())
