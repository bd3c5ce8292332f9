"""``make demo``: find the equations of a Lotka-Volterra system on two workers, and set them beside the true ones.

What runs is the ordinary command, as anybody would type it; this script only shows it and compares its result.
"""

import json
import subprocess
import sys
import time
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
    program = Path(sys.executable).parent / "coordinator"
    job = time.strftime("demo-%Y%m%d-%H%M%S")
    command = [_short(program), "run", DATA, "--workers", "2", "--id", job]
    say(f"$ {' '.join(command)}")
    process = subprocess.Popen(command)
    try:
        import sympy  # noqa: F401  loaded while the search runs

        code = process.wait()
    except KeyboardInterrupt:
        return process.wait() or 130
    if code != 0:
        return code
    result = json.loads((Path("runs") / job / "result.json").read_text("utf-8"))
    is_right = compare(result)
    say(f"\nall of it took {time.monotonic() - started:.1f} s; the whole result is in runs/{job}/result.json")
    say(f"next, a pendulum of which only the angle was measured:  {command[0]} run examples/pendulum.csv --order 2")
    return 0 if is_right else 1


def compare(result: dict[str, Any]) -> bool:
    """Print every constant beside the true one; return whether all are right to three digits."""
    say(f"\n{'':9}{'term':>6} {'found':>24} {'true':>5} {'relative error':>15}")
    terms = []
    for equation in result["equations"]:
        for number, term in enumerate(terms_of(equation["expression"], TRUTH[equation["variable"]])):
            head = f"{equation['lhs']} =" if number == 0 else ""
            say(f"{head:<9}{term.monomial:>6} {term.found:>24.17g} {term.true:>5g} {term.error:>15.1e}")
            terms.append(term)
    is_right = all(term.error < TOLERANCE for term in terms)
    say("every constant is right to 3 digits" if is_right else "these are not the true equations")
    return is_right


def terms_of(expression: str, truth: str) -> list[Term]:
    """Return the terms of both polynomials in x and y, those of the truth first."""
    found, true = _coefficients(expression), _coefficients(truth)
    extra = [monomial for monomial in found if monomial not in true and abs(found[monomial]) > NEGLIGIBLE]
    return [Term(monomial, found.get(monomial, 0.0), true.get(monomial, 0.0)) for monomial in [*true, *extra]]


def _coefficients(text: str) -> dict[str, float]:
    """Return the coefficient of every term of an expression multiplied out."""
    import sympy

    symbols = {name: sympy.Symbol(name) for name in TRUTH}
    expanded = sympy.expand(sympy.parse_expr(text, local_dict=symbols))
    pairs = (term.as_coeff_Mul() for term in sympy.Add.make_args(expanded))
    return {str(monomial): float(coefficient) for coefficient, monomial in pairs}


def say(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _short(program: Path) -> str:
    """Return the program's path as one would type it."""
    try:
        return str(program.relative_to(Path.cwd()))
    except ValueError:
        return str(program)


if __name__ == "__main__":
    sys.exit(main())
