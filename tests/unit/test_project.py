"""The project as a whole: what is packaged, what the documents promise, what is imported beside it."""

import argparse
import ast
import pkgutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

import atoll
from atoll.cli import exit_codes as exits
from atoll.cli import parser as arguments
from atoll_island_worker import cli as worker_cli
from tests.unit import documents
from tests.unit.documents import ROOT

PACKAGES = {
    "common": ["atoll_core"],
    "coordinator": ["atoll", "atoll_coordinator"],
    "island_worker": ["atoll_island_worker"],
}
"""The source roots, and the packages that each holds."""
DOCUMENTS = documents.texts()
COMMANDS = [(name, words) for name, text in DOCUMENTS.items() for words in documents.commands(text)]


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


def test_the_version_is_said_once(project: dict[str, Any]) -> None:
    assert project["project"]["version"] == atoll.VERSION
    assert f"## [{atoll.VERSION}]" in DOCUMENTS["CHANGELOG.md"]


def test_both_programs_are_installed_and_can_be_called(project: dict[str, Any]) -> None:
    scripts = project["project"]["scripts"]
    assert set(scripts) == set(documents.PROGRAMS)
    for name, target in scripts.items():
        assert callable(EntryPoint(name, target, "console_scripts").load())


def test_every_source_root_holds_its_packages_and_nothing_else(project: dict[str, Any]) -> None:
    build = project["tool"]["hatch"]["build"]
    assert build["dev-mode-dirs"] == list(PACKAGES)
    assert build["targets"]["wheel"]["packages"] == [
        f"{root}/{package}" for root, packages in PACKAGES.items() for package in packages
    ]
    for root, packages in PACKAGES.items():
        names = {item.name for item in (ROOT / root).iterdir()}
        assert sorted(name for name in names if not name.startswith(("__pycache__", "."))) == packages
        folders = {file.parent for file in (ROOT / root).rglob("*.py")}
        missing = [folder for folder in folders if not (folder / "__init__.py").exists()]
        assert not missing, "without __init__.py a folder is not shipped as a package"
        assert all((ROOT / root / package / "py.typed").exists() for package in packages)


def test_a_class_name_is_defined_once_in_the_product() -> None:
    modules: dict[str, list[str]] = {}
    for file in (file for root in PACKAGES for file in sorted((ROOT / root).rglob("*.py"))):
        for node in ast.parse(file.read_text("utf-8")).body:
            if isinstance(node, ast.ClassDef):
                modules.setdefault(node.name, []).append(str(file.relative_to(ROOT)))
    twice = [f"{name} in {' and '.join(files)}" for name, files in modules.items() if len(files) > 1]
    assert not twice, f"a class name means one thing; rename all but one of {'; '.join(twice)}"


def test_atoll_is_imported_beside_a_users_own_common_and_coordinator(tmp_path: Path) -> None:
    """A user's modules of the names of our source roots neither shadow our packages nor are shadowed by them."""
    (tmp_path / "common.py").write_text("MINE = 1\n")
    (tmp_path / "coordinator").mkdir()
    (tmp_path / "coordinator" / "__init__.py").write_text("MINE = 2\n")
    (tmp_path / "island_worker").mkdir()
    (tmp_path / "island_worker" / "__init__.py").write_text("MINE = 3\n")
    script = (
        "import atoll, atoll.cli.main, atoll_island_worker.cli, common, coordinator, island_worker\n"
        "print(common.MINE, coordinator.MINE, island_worker.MINE, atoll.VERSION)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout == f"1 2 3 {atoll.VERSION}\n", done.stderr


@pytest.mark.parametrize(("document", "words"), COMMANDS)
def test_commands_in_documents_are_understood(document: str, words: list[str]) -> None:
    assert parsed(words) is not None, f"{document}: {' '.join(words)}"


def test_the_documents_show_every_command() -> None:
    shown = {words[1] for _, words in COMMANDS if words[0] == "coordinator" and len(words) > 1}
    assert set(arguments.VERBS) - {"jobs", "workers"} <= shown
    assert any(words[0] == "island-worker" for _, words in COMMANDS)


@pytest.mark.parametrize("document", [name for name in DOCUMENTS if "adr" not in name])
def test_options_in_documents_exist(document: str) -> None:
    foreign = {
        "--scale",
        "--volumes",
        "--strict",
        "--coordinator",
        "--worker",
        "--submitter",
        "--admin",
        "--router",
        "--days",
    }
    assert documents.options(DOCUMENTS[document]) - foreign <= all_options(), document


@pytest.mark.parametrize("document", DOCUMENTS)
def test_make_targets_in_documents_exist(document: str) -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    missing = {target for target in documents.make_targets(DOCUMENTS[document]) if f"\n{target}:" not in makefile}
    assert missing == set()


@pytest.mark.parametrize("document", DOCUMENTS)
def test_links_in_documents_lead_somewhere(document: str) -> None:
    folder = (ROOT / document).parent
    assert {link for link in documents.links(DOCUMENTS[document]) if not (folder / link).exists()} == set()


def test_the_documents_have_the_exit_codes_that_the_programs_end_with() -> None:
    table = next(table for table in documents.tables(DOCUMENTS["docs/service.md"]) if table[0][0] == "exit code")
    said = {int(row[0]) for row in table[2:]}
    ours = {value for name, value in vars(exits).items() if name.isupper() and type(value) is int}
    assert said == ours | {error.exit_code for error in errors()}


def test_every_decision_has_its_number_and_stands_in_the_list() -> None:
    names = sorted(Path(name).name for name in DOCUMENTS if name.startswith("docs/adr/0"))
    assert len({name[:4] for name in names}) == len(names)
    for name in names:
        text = DOCUMENTS[f"docs/adr/{name}"]
        assert f"({name})" in DOCUMENTS["docs/adr/README.md"]
        assert text.startswith("# ")
        assert "**Decision.**" in text
        assert "**Consequences.**" in text


def test_words_of_the_glossary_live_where_it_says() -> None:
    for table in documents.tables(DOCUMENTS["docs/glossary.md"]):
        for word, _, place in table[2:]:
            assert pkgutil.resolve_name(place.strip("`")) is not None, word


def parsed(words: list[str]) -> argparse.Namespace | None:
    """Return a command line as its program understands it; raises UsageError."""
    if "--help" in words:
        return argparse.Namespace()
    if words[0] == "coordinator":
        return arguments.parse(words[1:])
    return worker_cli._parse(words[1:])


def all_options() -> set[str]:
    parsers = [arguments.build_parser()]
    for action in parsers[0]._actions:
        if isinstance(action, argparse._SubParsersAction):
            parsers += action.choices.values()
    ours = {option for parser in parsers for action in parser._actions for option in action.option_strings}
    return ours | {"--processes", "--wait", "--name", "--connect", "--lifetime", "--grace"}


def errors() -> Iterable[type[Any]]:
    from atoll_core.errors import AtollError

    return [AtollError, *AtollError.__subclasses__()]
