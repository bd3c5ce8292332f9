"""Draws what ``coordinator run`` prints as an SVG picture: ``python -m examples.picture docs/images/run.svg``.

The command is really run; what it writes on stderr while it works is left out.
"""

import io
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.text import Text

COMMAND = ("coordinator", "run", "examples/lotka_volterra.csv")
WIDTH = 96
FORMAT = """\
<svg class="rich-terminal" viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font-family: ui-monospace, Menlo, Consolas, monospace; font-size: {char_height}px;
line-height: {line_height}px; }}
.{unique_id}-title {{ font-size: 18px; font-weight: bold; font-family: sans-serif; }}
{styles}
</style>
<defs>
<clipPath id="{unique_id}-clip-terminal">
<rect x="0" y="0" width="{terminal_width}" height="{terminal_height}"/>
</clipPath>
{lines}
</defs>
{chrome}
<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}
<g class="{unique_id}-matrix">
{matrix}
</g>
</g>
</svg>
"""
"""An SVG without the fonts that rich would have loaded from the network."""


def printed() -> str:
    """Run the command and return what it prints on stdout."""
    program = Path(sys.executable).parent / COMMAND[0]
    with TemporaryDirectory() as folder:
        command = [str(program), *COMMAND[1:], "--out", f"{folder}/out"]
        return subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True).stdout


def drawn(output: str) -> str:
    """Return a picture of a terminal that shows the command and its `output`."""
    console = Console(record=True, width=WIDTH, file=io.StringIO())
    console.print(Text(f"$ {' '.join(COMMAND)}", style="bold"))
    for line in output.splitlines():
        if not line.startswith(("warning", "result in")):
            style = "bold green" if line.startswith("d") and " = " in line else ""
            console.print(Text(line, style=style, overflow="fold"))
    return console.export_svg(title="Atoll", code_format=FORMAT, unique_id="atoll")


def main(arguments: Sequence[str]) -> None:
    """Write the picture to the file that is named."""
    Path(arguments[0]).write_text(drawn(printed()), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
