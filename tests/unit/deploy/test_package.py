"""What is packaged and locked, and the files by which others join: workflows, templates, citation."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

from tests.unit.documents import ROOT

LOCK = ROOT / "requirements-dev.txt"


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    return dict(tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8")))


def read(name: str) -> dict[Any, Any]:
    return dict(yaml.safe_load((ROOT / name).read_text("utf-8")))


def test_a_wheel_installs_no_name_that_does_not_begin_with_atoll() -> None:
    packaged = [file.distribution_path for file in WheelBuilder(str(ROOT)).recurse_included_files()]
    assert {Path(name).parts[0] for name in packaged} == {
        "atoll",
        "atoll_coordinator",
        "atoll_core",
        "atoll_island_worker",
    }
    others = [name for name in packaged if not name.endswith((".py", "py.typed"))]
    page = [name for name in others if name.startswith("atoll/web/static/")]
    others = [name for name in others if name not in page]
    assert {Path(name).suffix for name in page} == {".html", ".js", ".css", ".svg", ".csv", ".LICENSE"}
    styles = ["atoll/report/page.css", "atoll/report/pictures.css"]
    schema = "atoll_coordinator/result/result.schema.json"
    description = "atoll/web/openapi.json"
    assert others == [*styles, description, schema], "only code, styles, the page and two schemas are installed"


def test_a_source_distribution_holds_what_the_wheel_is_built_from() -> None:
    shipped = {file.relative_path for file in SdistBuilder(str(ROOT)).recurse_included_files()}
    packaged = {file.relative_path for file in WheelBuilder(str(ROOT)).recurse_included_files()}
    assert packaged <= shipped
    assert {"README.md", "LICENSE", "CHANGELOG.md"} <= shipped
    assert not [name for name in shipped if name.startswith(("tests/", "benchmarks/"))]


def test_classifiers_fit_the_versions_of_python(project: dict[str, Any]) -> None:
    minors = [
        int(version[1])
        for classifier in project["project"]["classifiers"]
        if (version := re.fullmatch(r"Programming Language :: Python :: 3\.(\d+)", classifier))
    ]
    assert project["project"]["requires-python"] == f">=3.{min(minors)}"
    matrix = read(".github/workflows/tests.yml")["jobs"]["linux"]["strategy"]["matrix"]["python"]
    assert matrix == [f"3.{minor}" for minor in minors], "every version that is named is tested"


def test_the_lock_file_holds_every_requirement_with_hashes_and_names_no_index(project: dict[str, Any]) -> None:
    text = LOCK.read_text("utf-8")
    locked = re.findall(r"^([\w.-]+)==([\w.+]+)(.*)$", text, re.MULTILINE)
    required = [*project["project"]["dependencies"], *project["project"]["optional-dependencies"]["dev"]]
    names = {match[0].lower() for requirement in required if (match := re.match(r"[\w.-]+", requirement))}
    assert names <= {name for name, _, _ in locked}, "run make lock"
    assert all(rest.endswith("\\") for _, _, rest in locked), "a version without hashes"
    assert "://" not in text
    assert not re.search(r"^\s*-(i|-index-url|-extra-index-url|-find-links)", text, re.MULTILINE)


def test_the_citation_has_the_version_and_the_paper(project: dict[str, Any]) -> None:
    citation = read("CITATION.cff")
    assert citation["version"] == project["project"]["version"]
    assert citation["license"] == project["project"]["license"]
    (paper,) = citation["references"]
    assert [author["family-names"] for author in paper["authors"]] == ["Schmidt", "Lipson"]
