"""Builds the documentation as a site that is read without network: ``python docs/build_site.py site``.

Pages are the documents of the checkout, with their links rewritten to where they stand in the site, and pages that are
generated from the code: the command line, the configuration, the Python API.
"""

import argparse
import inspect
import json
import os
import posixpath
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, get_args

ROOT: Final = Path(__file__).resolve().parents[1]
OUTSIDE: Final = (
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "benchmarks/RESULTS.md",
    "deploy/README.md",
    "deploy/tls/README.md",
    "examples/README.md",
    "tests/README.md",
)
"""Documents that stand outside of ``docs``; the README is the front page."""

CONTENTS: Final = {
    "Start": ("tutorial", "concepts", "score", "comparison"),
    "How to": (
        "how-to/notebooks",
        "how-to/several-machines",
        "how-to/dask-ray",
        "how-to/executors",
        "how-to/noisy-data",
        "how-to/solver-data",
        "how-to/chaos",
        "how-to/forecasts",
        "how-to/prior-knowledge",
        "how-to/known-part",
        "how-to/known-part-examples",
        "hidden-states",
        "troubleshooting",
    ),
    "Reference": (
        "reference/command-line",
        "data",
        "reference/configuration",
        "result",
        "result-keys",
        "analysis",
        "export",
        "python",
        "reference/api",
        "reference/http",
        "reproducibility",
        "glossary",
    ),
    "Operations": (
        "service",
        "web",
        "operations",
        "scale",
        "project/deploy/README",
        "project/deploy/tls/README",
        "project/SECURITY",
    ),
    "For developers": (
        "architecture",
        "how-to/export-format",
        "protocol",
        "project/CONTRIBUTING",
        "project/tests/README",
        "adr/README",
        "project/benchmarks/RESULTS",
        "project/CHANGELOG",
        "project/examples/README",
    ),
}
"""Pages by part of the table of contents."""

_API: Final = (
    ("function", "atoll.api.discover.discover"),
    ("function", "atoll.api.discover.submit"),
    ("class", "atoll.api.discoverer.Discoverer"),
    ("class", "atoll.api.regressor.Regressor"),
    ("class", "atoll.api.model.Model"),
    ("class", "atoll.model.core.ModelCore"),
    ("class", "atoll.model.equations.DisplayedEquation"),
    ("class", "atoll.model.equations.Parameter"),
    ("class", "atoll.model.simulation.SimulationResult"),
    ("class", "atoll.analysis.analysis.Analysis"),
    ("function", "atoll.workers.start.start_on"),
    ("class", "atoll.workers.start.Handle"),
)
_SETTINGS: Final = """\
project = "Atoll"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = "Atoll"
myst_heading_anchors = 4
default_role = "code"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "exclude-members": "set_score_request"}
suppress_warnings = ["misc.highlighting_failure", "myst.header", "ref.python", "ref.ref", "ref.term"]
"""
_MENDED: Final = (
    ("<pre>", '<pre tabindex="0">'),
    ('<div class="table-wrapper', '<div tabindex="0" class="table-wrapper'),
    (' role="heading">', ' role="heading" aria-level="2">'),
)
"""What axe finds in the pages of the theme, and how it is written instead."""
_LINK: Final = re.compile(r"(!?)\[([^\]\[]*(?:\[[^\]]*\][^\]\[]*)*)\]\(([^)\s]+)\)")


def main(arguments: Sequence[str]) -> int:
    """Build the site into the folder that is named; return the exit code of sphinx."""
    (output,) = arguments
    with TemporaryDirectory() as folder:
        write_pages(Path(folder))
        command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", folder, output]
        code = subprocess.run(command, check=False).returncode
    open_to_everybody(Path(output))
    return code


def open_to_everybody(folder: Path) -> None:
    """Mend the pages that sphinx has built: what scrolls is reached by keyboard, and headings have a level."""
    for file in folder.rglob("*.html"):
        text = file.read_text("utf-8")
        for written, meant in _MENDED:
            text = text.replace(written, meant)
        file.write_text(text, "utf-8")


def write_pages(folder: Path) -> None:
    """Write all pages, images and settings from which sphinx builds the site."""
    (folder / "conf.py").write_text(_SETTINGS, "utf-8")
    for name, text in pages().items():
        _write(folder / name, text.encode())
    for image in (ROOT / "docs" / "images").iterdir():
        _write(folder / "images" / image.name, image.read_bytes())


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def pages() -> dict[str, str]:
    """Return the text of every page by its name in the site."""
    sources = [str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").rglob("*.md"))]
    found = {}
    for source in ("README.md", *OUTSIDE, *sources):
        page = place(source)
        assert page is not None
        found[page] = rewrite((ROOT / source).read_text("utf-8"), source, page)
    found["index.md"] += "".join(_toctree(name, CONTENTS[name]) for name in CONTENTS)
    decisions = sorted(Path(name).stem for name in found if re.match(r"adr/\d", name))
    found["adr/README.md"] += _toctree("Decisions", decisions)
    return found | {
        "reference/command-line.md": command_line(),
        "reference/configuration.md": configuration(),
        "reference/api.md": api(),
        "reference/http.md": http_api(),
    }


def http_api() -> str:
    """Return the reference of the API over HTTP, made of its description."""
    described = json.loads((ROOT / "coordinator/atoll/web/openapi.json").read_text("utf-8"))
    parts = ["# API over HTTP\n\nBelow `/api/v1`, as `openapi.json` there describes it.\n"]
    for path, operations in described["paths"].items():
        for method, operation in operations.items():
            parts.append(f"\n## {method.upper()} {path}\n\n{operation['summary']}\n\n")
            given = [parameter for parameter in operation.get("parameters", ()) if parameter["in"] != "path"]
            lines = (f"- `{one['name']}` ({one['in']}): {one.get('description', 'see above')}\n" for one in given)
            answers = ", ".join(f"{code} ({answer['description']})" for code, answer in operation["responses"].items())
            parts.append("".join([*lines, f"\nAnswers: {answers}.\n"]))
    return "".join(parts)


def _toctree(caption: str, names: Sequence[str]) -> str:
    return f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n" + "\n".join(names) + "\n```\n"


def rewrite(markdown: str, source: str, page: str) -> str:
    """Return a text with its links rewritten; `source` is its path in the checkout, `page` that in the site.

    Of links to what is no page, such as a file of data, the text stays.
    """

    def replaced(found: re.Match[str]) -> str:
        mark, text, target = found.groups()
        path, hash_mark, anchor = target.partition("#")
        if "://" in target or not path:
            return found[0]
        goal = place(posixpath.normpath(posixpath.join(posixpath.dirname(source), path)))
        if goal is None:
            return text
        return f"{mark}[{text}]({posixpath.relpath(goal, posixpath.dirname(page) or '.')}{hash_mark}{anchor})"

    return _LINK.sub(replaced, markdown)


def place(path: str) -> str | None:
    """Return where a path of the checkout stands in the site; None of what is no page there."""
    if path == "README.md":
        return "index.md"
    if path in ("docs/adr", "deploy", "deploy/tls", "examples", "tests"):
        path += "/README.md"
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    return f"project/{path}" if path in OUTSIDE else None


def command_line() -> str:
    """Return the help of both programs and of every command."""
    from atoll.cli.parser import build_parser

    os.environ["COLUMNS"] = "100"
    parser = build_parser()
    verbs = next(each for each in parser._actions if isinstance(each, argparse._SubParsersAction))
    helps = {"coordinator": parser.format_help()}
    helps |= {f"coordinator {name}": verb.format_help() for name, verb in verbs.choices.items()}
    worker = [sys.executable, "-m", "atoll_island_worker", "--help"]
    helps["island-worker"] = subprocess.run(worker, capture_output=True, text=True, check=True).stdout
    parts = (f"\n## {name}\n\n```text\n{text.rstrip()}\n```\n" for name, text in helps.items())
    return "# Command line\n" + "".join(parts)


def configuration() -> str:
    """Return every key of a job file with its type, its default and its meaning."""
    from atoll_core.config import JobConfig

    head = (
        "# Configuration\n\nA job file, `--config job.toml`, has these keys; most have an option of the command line, "
        'and `atoll.discover(config="job.toml")` reads it in Python.\n'
    )
    return head + "".join(_tables(JobConfig, ""))


def _tables(model: Any, prefix: str) -> Iterator[str]:
    """Yield a table for the keys of a model, then those of the models inside it."""
    rows, inside = [], []
    for name, field in model.model_fields.items():
        if _is_model(field.annotation):
            inside.append((f"{prefix}{name}.", field.annotation))
            continue
        default = "" if field.is_required() else f"`{field.get_default(call_default_factory=True)!r}`"
        cells = (f"`{name}`", f"`{_kind(field.annotation)}`", default, field.description or "")
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    if rows:
        title = f"`[{prefix[:-1]}]`" if prefix else "At the top"
        yield f"\n## {title}\n\n{inspect.cleandoc(model.__doc__)}\n\n"
        yield "| key | type | default | meaning |\n|---|---|---|---|\n" + "\n".join(rows) + "\n"
    for name, nested in inside:
        yield from _tables(nested, name)


def _is_model(annotation: Any) -> bool:
    from pydantic import BaseModel

    return isinstance(annotation, type) and not get_args(annotation) and issubclass(annotation, BaseModel)


def _kind(annotation: Any) -> str:
    """Return a type as text, without what it is annotated with."""
    if isinstance(annotation, type) and not get_args(annotation):
        return annotation.__name__
    text = re.sub(r"typing\.Annotated\[([\w.]+), .*?\]\)?\]", r"\1", str(annotation))
    text = re.sub(r"typing\.Annotated\[([\w.]+), [^\]]*\]", r"\1", text)
    return re.sub(r"\b(?:typing|atoll\.config)\.", "", text).replace("NoneType", "None")


def api() -> str:
    """Return the page that autodoc fills from the docstrings."""
    parts = (f"```{{eval-rst}}\n.. auto{kind}:: {name}\n```\n" for kind, name in _API)
    return "# Python API\n\nAll of these are attributes of `atoll`, or what these return.\n\n" + "\n".join(parts)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
