"""``make demo``: find the equations of a Lotka-Volterra system on two workers, and set them beside the true ones.

What runs is the ordinary command, as anybody would type it; this script only shows it and compares its result.
"""

import ast
import contextlib
import functools
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

DATA = "examples/lotka_volterra.csv"
TRUTH = {"x": "3*x - 2*x*y - x**2", "y": "2*y - x*y - y**2"}
TOLERANCE = 5e-4
"""Relative error of a constant that is right to three digits."""
NEGLIGIBLE = 1e-6
"""Terms with a smaller coefficient are rounding left over from rearranging a product; the states are of order 1."""


class Term(NamedTuple):
    """One term of an equation: its coefficient as found (0: it is lacking) and in truth (0: it should not be there)."""

    monomial: str
    found: float
    true: float

    @property
    def error(self) -> float:
        """Relative error of the coefficient."""
        return abs(self.found - self.true) / abs(self.true) if self.true else float("inf")


def main() -> int:
    """Run the search, show the comparison; return 0 when every constant is right to three digits."""
    started = time.monotonic()
    program, here = Path(sys.executable).parent / "coordinator", Path.cwd()
    typed = program.relative_to(here) if program.is_relative_to(here) else program
    job = time.strftime("demo-%Y%m%d-%H%M%S")
    command = [str(typed), "run", DATA, "--workers", "2", "--id", job]
    say(f"$ {' '.join(command)}")
    code = run(command)
    if code != 0:
        return code
    result = json.loads((Path("runs") / job / "result.json").read_text("utf-8"))
    is_right = compare(result)
    say(f"\nall of it took {time.monotonic() - started:.1f} s; the whole result is in runs/{job}/result.json")
    say(f"next, a pendulum of which only the angle was measured:  {command[0]} run examples/pendulum.csv --order 2")
    say(f"or your own data, watched in a browser:  {command[0]} run YOUR.csv --web")
    return 0 if is_right else 1


def run(command: Sequence[str]) -> int:
    """Run a command to its end, also when Ctrl-C tells both of us to stop; return its exit code."""
    process = subprocess.Popen(command)
    with contextlib.suppress(KeyboardInterrupt):
        return process.wait()
    return process.wait()


def compare(result: dict[str, Any]) -> bool:
    """Print every constant beside the true one; return whether all are right to three digits."""
    say(f"\n{'':9}{'term':>6} {'found':>24} {'true':>5} {'relative error':>15}")
    try:
        terms = [term for equation in result["equations"] for term in _compared(equation)]
    except ValueError as error:
        say(f"these are not the true equations: {error}")
        return False
    is_right = all(term.error < TOLERANCE for term in terms)
    say("every constant is right to 3 digits" if is_right else "these are not the true equations")
    return is_right


def _compared(equation: dict[str, Any]) -> list[Term]:
    terms = terms_of(equation["expression"], TRUTH[equation["variable"]])
    for number, term in enumerate(terms):
        head = f"{equation['lhs']} =" if number == 0 else ""
        say(f"{head:<9}{term.monomial:>6} {term.found:>24.17g} {term.true:>5g} {term.error:>15.1e}")
    return terms


def terms_of(expression: str, truth: str) -> list[Term]:
    """Return the terms of both polynomials in x and y, those of the truth first; raises ValueError."""
    found, true = polynomial(expression), polynomial(truth)
    extra = [powers for powers in found if powers not in true and abs(found[powers]) > NEGLIGIBLE]
    return [Term(_name(powers), found.get(powers, 0.0), true.get(powers, 0.0)) for powers in [*true, *extra]]


Polynomial = dict[tuple[int, int], float]
"""Coefficient by powers of x and y."""


def polynomial(text: str) -> Polynomial:
    """Return an expression in x and y multiplied out; raises ValueError when it is no polynomial."""
    return _polynomial(ast.parse(text, mode="eval").body)


def _polynomial(node: ast.expr) -> Polynomial:
    match node:
        case ast.Constant(value=int() | float() as value):
            return {(0, 0): float(value)}
        case ast.Name(id="x" | "y" as name):
            return {(1, 0) if name == "x" else (0, 1): 1.0}
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return _product({(0, 0): -1.0}, _polynomial(operand))
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() as power)):
            return functools.reduce(_product, [_polynomial(left)] * power, {(0, 0): 1.0})
        case ast.BinOp(left=left, op=operator, right=right):
            first, second = _polynomial(left), _polynomial(right)
            match operator:
                case ast.Add():
                    return _sum(first, second)
                case ast.Sub():
                    return _sum(first, _product({(0, 0): -1.0}, second))
                case ast.Mult():
                    return _product(first, second)
                case ast.Div() if set(second) == {(0, 0)}:
                    return _product(first, {(0, 0): 1.0 / second[0, 0]})
            raise ValueError("only polynomials in x and y are compared here")
    raise ValueError(f"{ast.unparse(node)} is no polynomial in x and y")


def _sum(left: Polynomial, right: Polynomial) -> Polynomial:
    return {powers: left.get(powers, 0.0) + right.get(powers, 0.0) for powers in [*left, *right]}


def _product(left: Polynomial, right: Polynomial) -> Polynomial:
    terms = ({(a + c, b + d): first * second} for (a, b), first in left.items() for (c, d), second in right.items())
    return functools.reduce(_sum, terms, {})


def _name(powers: tuple[int, int]) -> str:
    """Return ``x*y`` for (1, 1), ``x^2`` for (2, 0), ``1`` for (0, 0)."""
    parts = [name if power == 1 else f"{name}^{power}" for name, power in zip("xy", powers, strict=True) if power]
    return "*".join(parts) or "1"


def say(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
