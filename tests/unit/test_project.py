"""The project as a whole: what is packaged, what the documents promise, whose `common` is imported."""

import argparse
import os
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from fnmatch import fnmatch
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

import common
from common.config import PRESETS
from coordinator.cli import arguments, exits
from coordinator.cli.options import job_config
from coordinator.service.resolve import STAGNATION_CLEAN, STAGNATION_NOISY
from island_worker import cli as worker_cli
from tests.unit import documents
from tests.unit.documents import ROOT

PACKAGES = {"common", "coordinator", "island_worker"}
DOCUMENTS = documents.texts()
COMMANDS = [(name, words) for name, text in DOCUMENTS.items() for words in documents.commands(text)]


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


def folders_with_modules() -> set[str]:
    """Return the dotted names of the folders of the checkout that hold Python modules."""
    hidden_or_built = (".", "build", "dist")
    tops = [top for top in ROOT.iterdir() if top.is_dir() and not top.name.startswith(hidden_or_built)]
    files = [file.relative_to(ROOT) for top in tops for file in top.rglob("*.py")]
    return {".".join(file.parent.parts) for file in files}


def test_the_version_is_said_once(project: dict[str, Any]) -> None:
    assert project["project"]["version"] == common.VERSION
    assert f"## [{common.VERSION}]" in DOCUMENTS["CHANGELOG.md"]


@pytest.mark.parametrize("number", ["protocol", "engine"])
def test_the_changelog_names_protocol_and_engine(number: str) -> None:
    value = {"protocol": common.PROTOCOL_VERSION, "engine": common.ENGINE_REVISION}[number]
    assert f"{number} {value}" in DOCUMENTS["CHANGELOG.md"].lower()


def test_both_programs_are_installed_and_can_be_called(project: dict[str, Any]) -> None:
    scripts = project["project"]["scripts"]
    assert set(scripts) == set(documents.PROGRAMS)
    for name, target in scripts.items():
        assert callable(EntryPoint(name, target, "console_scripts").load())


def test_exactly_our_packages_are_installed(project: dict[str, Any]) -> None:
    patterns = project["tool"]["setuptools"]["packages"]["find"]["include"]
    shipped = {name for name in folders_with_modules() if any(fnmatch(name, pattern) for pattern in patterns)}
    assert {name.split(".")[0] for name in shipped} == PACKAGES
    missing = [name for name in shipped if not (ROOT / Path(*name.split(".")) / "__init__.py").exists()]
    assert not missing, "without __init__.py a foreign package could take the place of ours"


def test_files_that_the_distribution_names_are_there(project: dict[str, Any]) -> None:
    named = [project["project"]["readme"], *project["project"]["license-files"]]
    assert [name for name in named if not (ROOT / name).is_file()] == []
    assert "Apache License" in (ROOT / "LICENSE").read_text("utf-8")
    assert project["project"]["license"] == "Apache-2.0"


@pytest.mark.parametrize(("module", "attribute"), [("coordinator.cli.main", "main"), ("island_worker.cli", "main")])
def test_a_foreign_common_is_named_in_one_sentence(module: str, attribute: str, tmp_path: Path) -> None:
    """Another distribution has put its package `common` in front of ours."""
    (tmp_path / "common").mkdir()
    (tmp_path / "common" / "__init__.py").write_text("VERSION = '9'\n")
    script = f"import sys; from {module} import {attribute}; sys.exit({attribute}(['--version']))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert done.stdout == ""
    (sentence,) = done.stderr.splitlines()
    assert str(tmp_path / "common" / "__init__.py") in sentence
    assert "not Atoll's package" in sentence


@pytest.mark.parametrize(("document", "words"), COMMANDS)
def test_commands_in_documents_are_understood(document: str, words: list[str]) -> None:
    assert parsed(words) is not None, f"{document}: {' '.join(words)}"


def test_the_job_file_in_the_readme_is_understood(tmp_path: Path) -> None:
    (text,) = re.findall(r"^```toml\n(.*?)^```", DOCUMENTS["README.md"], re.MULTILINE | re.DOTALL)
    (tmp_path / "job.toml").write_text(text)
    config = job_config(arguments.parse(["run", "x.csv", "--config", str(tmp_path / "job.toml")]))
    assert config.model_dump(mode="json", exclude_defaults=True) == tomllib.loads(text)


def test_the_readme_says_when_searches_end() -> None:
    budget, paper = PRESETS["default"].budget, PRESETS["paper"].budget
    text = " ".join(DOCUMENTS["README.md"].split())
    assert f"none has improved for {STAGNATION_CLEAN} epochs, or after {budget.max_epochs} epochs" in text
    assert f"nothing has improved for {STAGNATION_NOISY} epochs" in text
    assert f"({paper.stagnation} and {paper.max_epochs} with preset `paper`)" in text


def test_the_readme_shows_every_command() -> None:
    shown = {words[1] for _, words in COMMANDS if words[0] == "coordinator" and len(words) > 1}
    assert set(arguments.HANDLERS) - {"jobs", "workers"} <= shown
    assert any(words[0] == "island-worker" for _, words in COMMANDS)


@pytest.mark.parametrize("document", [name for name in DOCUMENTS if "adr" not in name])
def test_options_in_documents_exist(document: str) -> None:
    foreign = {"--scale", "--volumes", "--strict"}
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


def test_the_readme_has_the_exit_codes_that_the_programs_end_with() -> None:
    table = next(table for table in documents.tables(DOCUMENTS["README.md"]) if table[0][0] == "exit code")
    said = {int(row[0]) for row in table[2:]}
    ours = {value for name, value in vars(exits).items() if name.isupper()}
    assert said == ours | {error.exit_code for error in errors()}


def test_every_decision_has_its_number_and_stands_in_the_list() -> None:
    names = sorted(Path(name).name for name in DOCUMENTS if name.startswith("docs/adr/0"))
    assert [int(name[:4]) for name in names] == list(range(1, len(names) + 1))
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
    from common.errors import AtollError

    return [AtollError, *AtollError.__subclasses__()]
