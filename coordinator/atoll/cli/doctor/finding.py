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


def fine(subject: str, found: str) -> Finding:
    """Return a finding about which nothing needs to be done."""
    return Finding(subject, "fine", found)


def problem(subject: str, error: AtollError) -> Finding:
    """Return a finding in the words of an error: what was found, and after a semicolon what to do."""
    found, _, advice = error.on_command_line.partition("; ")
    return Finding(subject, "problem", found, advice)


def as_text(findings: Sequence[Finding]) -> str:
    """Return one line for each finding, the advice on a line of its own, and a summary."""
    width = max(len(each.subject) for each in findings)
    lines = []
    for each in findings:
        first, *rest = each.found.splitlines() or [""]
        indent = " " * (len(_MARKS["fine"]) + width + 4)
        lines.append(f"{_MARKS[each.grade]}  {each.subject.ljust(width)}  {first}")
        lines += [indent + line for line in rest]
        lines += [f"{indent}-> {each.advice}"] if each.advice else []
    problems, warnings = (sum(each.grade == grade for each in findings) for grade in ("problem", "warning"))
    return "\n".join([*lines, f"{_counted(problems, 'problem')}, {_counted(warnings, 'warning')}"])


def as_tree(findings: Sequence[Finding]) -> dict[str, object]:
    """Return the findings for JSON."""
    return {
        "fine": all(each.grade != "problem" for each in findings),
        "findings": [asdict(each) for each in findings],
    }


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")
