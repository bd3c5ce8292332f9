"""What the documents say, taken apart: code blocks, commands, options, links."""

import re
import shlex
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PROGRAMS = ("coordinator", "island-worker")
LANGUAGES = ("console", "csv", "mermaid", "python", "sh", "text", "toml")
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_COMMAND = re.compile(r"(?:\$ )?(?:docker .* )?(?:[\w.-]+/)*((?:coordinator|island-worker)(?: .*)?)$")
"""A command line; with docker, the last name of a program is the program's, earlier ones are services."""


class Block(NamedTuple):
    """A code block of a page; the language is "" where none is named."""

    page: str
    line: int
    language: str
    text: str

    @property
    def output(self) -> list[str]:
        """What a program is said to print, without commands and without what is left out."""
        lines = (line.strip() for line in self.text.splitlines())
        return [line for line in lines if line and not line.startswith("$ ") and line not in ("...", "…")]


def texts() -> dict[str, str]:
    """Return the documents by their path in the checkout."""
    files = [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/**/*.md"),
        *ROOT.glob("deploy/**/*.md"),
        ROOT / "examples" / "README.md",
    ]
    return {str(file.relative_to(ROOT)): file.read_text("utf-8") for file in sorted(files)}


def blocks(page: str, text: str) -> list[Block]:
    """Return the code blocks of a page."""
    return [Block(page, text[: at.start()].count("\n") + 1, at[1], at[2]) for at in _FENCE.finditer(text)]


def commands(text: str) -> list[list[str]]:
    """Return the words of every command of ours in the code blocks of `text`, the program's name first."""
    matches = (_COMMAND.match(line) for block in blocks("", text) for line in block.text.splitlines())
    return [shlex.split(match[1], comments=True) for match in matches if match]


def make_targets(text: str) -> set[str]:
    """Return the targets of every ``make`` in `text`."""
    return set(re.findall(r"(?:^|`)make ([a-z-]+)", text, re.MULTILINE))


def options(text: str) -> set[str]:
    """Return the long options that stand at the beginning of inline code."""
    return {option for code in re.findall(r"`([^`\n]+)`", text) for option in re.findall(r"^--[a-z][a-z-]+", code)}


def links(text: str) -> set[str]:
    """Return the relative targets of links, without anchors."""
    targets = (target.split("#")[0] for target in re.findall(r"\]\(([^)\s]+)\)", text))
    return {target for target in targets if target and "://" not in target}


def tables(text: str) -> list[list[list[str]]]:
    """Return the cells of every table of `text`, heads included."""
    tables: list[list[list[str]]] = [[]]
    for line in text.splitlines():
        if line.startswith("|"):
            tables[-1].append([cell.strip() for cell in line.strip().strip("|").split("|")])
        elif tables[-1]:
            tables.append([])
    return [table for table in tables if table]
