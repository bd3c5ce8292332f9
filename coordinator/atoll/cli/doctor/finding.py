"""What ``coordinator doctor`` finds: one thing looked at, how it is, and what to do about it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Final, Literal

from atoll_core.errors import AtollError

Grade = Literal["fine", "warning", "problem"]

_MARKS: Final[dict[Grade, str]] = {"fine": "ok     ", "warning": "warning", "problem": "PROBLEM"}


@dataclass(frozen=True, slots=True)
class Finding:
    """`found` is what was found of `subject`; `advice` what to do, "" where nothing needs to be done."""

    subject: str
    grade: Grade
    found: str
    advice: str = ""


def fine(subject: str, fact: str) -> Finding:
    """Return a finding about which nothing needs to be done."""
    return Finding(subject, "fine", fact)


def problem(subject: str, error: AtollError) -> Finding:
    """Return a finding in the words of an error: what was found, and after a semicolon what to do."""
    fact, _, advice = error.on_command_line.partition("; ")
    return Finding(subject, "problem", fact, advice)


def counted(count: int, noun: str) -> str:
    """Return a count of things, such as ``1 problem`` and ``2 processes``."""
    return f"{count} {noun}" + ("" if count == 1 else "es" if noun.endswith("s") else "s")


def as_text(findings: Sequence[Finding]) -> str:
    """Return one line for each finding, the advice on a line of its own, and a summary."""
    width = max(len(finding.subject) for finding in findings)
    lines = []
    for finding in findings:
        first, *rest = finding.found.splitlines() or [""]
        indent = " " * (len(_MARKS["fine"]) + width + 4)
        lines.append(f"{_MARKS[finding.grade]}  {finding.subject.ljust(width)}  {first}")
        lines += [indent + line for line in rest]
        lines += [f"{indent}-> {finding.advice}"] if finding.advice else []
    problems, warnings = (sum(finding.grade == grade for finding in findings) for grade in ("problem", "warning"))
    return "\n".join([*lines, f"{counted(problems, 'problem')}, {counted(warnings, 'warning')}"])


def as_tree(findings: Sequence[Finding]) -> dict[str, object]:
    """Return the findings for JSON."""
    return {
        "fine": all(finding.grade != "problem" for finding in findings),
        "findings": [asdict(finding) for finding in findings],
    }
