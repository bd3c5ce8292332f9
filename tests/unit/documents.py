"""What the documents say, taken apart: commands in code blocks, options, links."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROGRAMS = ("coordinator", "island-worker")
_COMMAND = re.compile(r"(?:\$ )?(?:docker .* )?(?:[\w.-]+/)*((?:coordinator|island-worker)(?: .*)?)$")
"""A command line; with docker, the last name of a program is the program's, earlier ones are services."""


def texts() -> dict[str, str]:
    """Return the documents by their path in the checkout."""
    files = [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/**/*.md"),
        ROOT / "deploy" / "README.md",
        ROOT / "examples" / "README.md",
    ]
    return {str(file.relative_to(ROOT)): file.read_text("utf-8") for file in sorted(files)}


def commands(text: str) -> list[list[str]]:
    """Return the words of every command of ours in the code blocks of `text`, the program's name first."""
    matches = (_COMMAND.match(line) for line in _code(text))
    return [shlex.split(match[1], comments=True) for match in matches if match]


def make_targets(text: str) -> set[str]:
    """Return the targets of every ``make`` in `text`."""
    return set(re.findall(r"(?:^|`)make ([a-z-]+)", text, re.MULTILINE))


def options(text: str) -> set[str]:
    """Return the long options that stand at the beginning of inline code."""
    return {each for code in re.findall(r"`([^`\n]+)`", text) for each in re.findall(r"^--[a-z][a-z-]+", code)}


def links(text: str) -> set[str]:
    """Return the relative targets of links, without anchors."""
    targets = (target.split("#")[0] for target in re.findall(r"\]\(([^)\s]+)\)", text))
    return {target for target in targets if target and "://" not in target}


def tables(text: str) -> list[list[list[str]]]:
    """Return the cells of every table of `text`, heads included."""
    found: list[list[list[str]]] = [[]]
    for line in text.splitlines():
        if line.startswith("|"):
            found[-1].append([cell.strip() for cell in line.strip().strip("|").split("|")])
        elif found[-1]:
            found.append([])
    return [table for table in found if table]


def _code(text: str) -> list[str]:
    """Return the lines of fenced and indented code blocks."""
    fences = re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    fenced = [line for fence in fences for line in fence.splitlines()]
    return fenced + [line.strip() for line in text.splitlines() if line.startswith("    .venv/")]
