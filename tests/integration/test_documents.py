"""The commands and the code of pages of the documentation do what these pages say."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.unit import documents
from tests.unit.documents import ROOT

PROGRAMS = Path(sys.executable).parent


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder with the examples, as a reader of the pages has it."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    return tmp_path


def run(words: list[str], folder: Path) -> str:
    environment = {**os.environ, "TMPDIR": str(folder)}
    found = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=200, check=False)
    assert found.returncode == 0, (words, found.stdout, found.stderr)
    return found.stdout


def test_the_tutorial_and_the_page_on_notebooks_do_what_they_say(checkout: Path) -> None:
    tutorial, notebooks = (
        (ROOT / "docs" / f"{name}.md").read_text("utf-8") for name in ("tutorial", "how-to/notebooks")
    )
    outputs = [run([str(PROGRAMS / words[0]), *words[1:]], checkout) for words in documents.commands(tutorial)]
    found, simulated, analysed = outputs
    shown = next(block for block in blocks(tutorial, "") if "doubtful" in block)
    assert {line.strip() for line in shown.splitlines()} <= {line.strip() for line in found.splitlines()}
    assert simulated.startswith("year,hare,")
    assert "centre" in analysed
    (checkout / "pages.py").write_text("\n".join([*blocks(tutorial, "python"), *blocks(notebooks, "python")]), "utf-8")
    assert "dhare/dyear = hare*(0.538 - 0.0281*lynx)" in run([sys.executable, "pages.py"], checkout)
    assert "</html>" in (checkout / "runs" / "hares" / "report.html").read_text("utf-8")


def blocks(text: str, language: str) -> list[str]:
    """Return the code blocks of a page in a language."""
    found: list[str] = re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return found
