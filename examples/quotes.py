"""What pages say of the hares and lynxes: ``python -m examples.quotes`` runs the example and writes it into them.

Lines that the run prints, in blocks of code, and numbers in sentences, or a comparison with another candidate, between
``<!-- hares: NAME -->`` and ``<!-- end -->``. A test compares both with a run; read what moved, since sentences around
a number may have to follow.
"""

import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from atoll.api.model import Model
from atoll.model.equations import plus_minus

ROOT: Final = Path(__file__).resolve().parents[1]
PAGES: Final = ("README.md", "docs/tutorial.md", "docs/result.md", "docs/analysis.md")
EXAMPLE: Final = ("examples/lynx_hare.csv", "--time", "year")

MARK: Final = re.compile(r"<!-- hares: (?P<name>[\w.]+) -->(?P<text>.*?)<!-- end -->", re.DOTALL)
_BLOCK: Final = re.compile(r"^```\w+\n.*?^```", re.MULTILINE | re.DOTALL)
_EQUATION: Final = re.compile(r"(d(?:hare|lynx)/dyear) = ")
_VERDICTS: Final = ("exact", "good", "doubtful", "no model")

Lines = dict[tuple[str, str], str]
"""Printed lines by the equation that they belong to, "" of none, and what stands before their colon."""


class QuoteError(Exception):
    """Raised where a page quotes what the example does not print."""


def run_example(folder: Path) -> tuple[str, Model]:
    """Run the example on two workers; return what it prints, and its model."""
    words = (sys.executable, "-m", "atoll", "run", *EXAMPLE, "--workers", "2", "--out", str(folder))
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout, Model.load(folder)


def printed_lines(text: str) -> Lines:
    """Return what the run prints by equation and key."""
    lines: Lines = {}
    equation = ""
    for line in text.splitlines():
        equation, key = _place(line, equation)
        lines.setdefault((equation, key), line)
    return lines


def _place(line: str, equation: str) -> tuple[str, str]:
    """Return of which equation a line is, `equation` being that of the line before, and its key."""
    if begun := _EQUATION.match(line):
        return begun[1], "equation"
    key = line.strip().partition(":")[0]
    return (equation if line.startswith("    ") else ""), "verdict" if key in _VERDICTS else key


def numbers_of(model: Model) -> dict[str, str]:
    """Return the numbers that sentences quote, by name."""
    result, analysis = model.result, model.analyse()
    hare, lynx = result.equations
    balance, rest = hare.constants[1], lynx.constants[-1]
    value, _, error = plus_minus(balance.estimate, balance.std_error or 0.0).partition(" ± ")
    centre = next(point.point for point in analysis.fixed_points.points if point.kind == "centre")
    (comparison,) = analysis.comparisons
    predators = re.compile(r"lynx\*\(([\d.]+\*)?hare - [\d.]+\)$")
    theirs = next(other for other in lynx.candidates if predators.search(other.expression))
    noise = [result.noise[name].relative or 0.0 for name in ("hare", "lynx")]
    return {
        "balance": value,
        "balance.error": error,
        "rest": f"{rest.value:.6g}",
        "centre.hare": f"{centre[0]:.0f}",
        "centre.lynx": f"{centre[1]:.0f}",
        "period": f"{comparison.orbit_period:.1f}",
        "noise": " and ".join(f"{100.0 * share:.0f}" for share in noise) + " %",
        "floors": " and ".join(f"{equation.derivative_floor:.2f}" for equation in (hare, lynx)),
        "theirs.nats": f"{theirs.nats:.1f}",
        "compare": compared_block(str(model.compare(model.candidates[1]))),
    }


def compared_block(text: str) -> str:
    """Return a comparison as a block of code, without the lines that name both models, and without equations."""
    lines = [re.sub(r"( constants); .*", r"\1; …", line) for line in text.splitlines()]
    return "\n".join(["", "```text", *(line for line in lines if not re.match(r"[AB] = ", line)), "```", ""])


def requoted(page: str, lines: Lines, numbers: Mapping[str, str]) -> str:
    """Return a page with what the example prints and finds now; raises QuoteError where it has no such thing."""

    def number(mark: re.Match[str]) -> str:
        if mark["name"] not in numbers:
            raise QuoteError(f"there is no number {mark['name']!r} of the hares; there are {', '.join(numbers)}")
        return f"<!-- hares: {mark['name']} -->{numbers[mark['name']]}<!-- end -->"

    page = MARK.sub(number, page)
    return _BLOCK.sub(lambda block: _block(block[0], lines) if _EQUATION.search(block[0]) else block[0], page)


def _block(block: str, lines: Lines) -> str:
    first, *inner, last = block.splitlines()
    equation, made = "", [first]
    for line in inner:
        if line.startswith("$ ") or line == "...":
            made.append(line)
            equation = equation if line == "..." else ""
            continue
        equation, key = _place(line, equation)
        if (equation, key) not in lines:
            raise QuoteError(f"the example no longer prints {key!r}{f' of {equation}' * bool(equation)}; edit the page")
        made.append(lines[equation, key])
    return "\n".join([*made, last])


def main(pages: Sequence[str] = PAGES) -> int:
    """Write what the example prints and finds now into the pages; return the exit code."""
    with tempfile.TemporaryDirectory() as folder:
        text, model = run_example(Path(folder) / "hares")
    lines, numbers = printed_lines(text), numbers_of(model)
    for name in pages:
        path = ROOT / name
        before = path.read_text("utf-8")
        after = requoted(before, lines, numbers)
        path.write_text(after, "utf-8")
        sys.stdout.write(f"{name}: {'changed' if after != before else 'as it was'}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
