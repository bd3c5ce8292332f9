"""The pages of the site: every link leads to a page, all documents are in the contents, references follow the code."""

import importlib.util
import posixpath
import re
from pathlib import Path
from types import ModuleType

import pytest

from tests.unit import documents
from tests.unit.documents import ROOT


@pytest.fixture(scope="module")
def site() -> ModuleType:
    spec = importlib.util.spec_from_file_location("build_site", ROOT / "docs" / "build_site.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def pages(site: ModuleType) -> dict[str, str]:
    return site.pages()  # type: ignore[no-any-return]


def test_links_lead_to_pages_and_images(pages: dict[str, str]) -> None:
    known = {*pages, *(f"images/{path.name}" for path in (ROOT / "docs" / "images").iterdir())}
    broken = [
        (name, link)
        for name, text in pages.items()
        for link in documents.links(text)
        if posixpath.normpath(posixpath.join(posixpath.dirname(name), link)) not in known
    ]
    assert broken == []


def test_what_the_reference_lists_is_there(site: ModuleType) -> None:
    """By the text of the modules: some of them need libraries that are not installed everywhere."""
    for kind, name in site._API:
        module, _, what = name.rpartition(".")
        text = (ROOT / "coordinator" / f"{module.replace('.', '/')}.py").read_text("utf-8")
        word = {"function": "def", "class": "class"}[kind]
        assert re.search(rf"^{word} {what}\b|^from .* import .*\b{what}\b", text, re.MULTILINE), name


def test_every_page_is_in_the_contents(site: ModuleType, pages: dict[str, str]) -> None:
    listed = {f"{name}.md" for names in site.CONTENTS.values() for name in names}
    decisions = {name for name in pages if name.startswith("adr/0")}
    assert listed | decisions | {"index.md"} == set(pages)


def test_links_are_rewritten_and_those_to_files_of_the_checkout_become_text(site: ModuleType) -> None:
    text = "[a](../README.md#start) [b](../examples/lynx_hare.csv) [c](https://zenoh.io) ![e](images/x.svg)"
    spec = site.rewrite(text, "docs/result.md", "result.md")
    assert spec == "[a](index.md#start) b [c](https://zenoh.io) ![e](images/x.svg)"
    assert site.rewrite("[a](docs/data.md)", "README.md", "index.md") == "[a](data.md)"
    assert site.rewrite("[a](../README.md)", "deploy/README.md", "project/deploy/README.md") == "[a](../../index.md)"


def test_what_scrolls_is_reached_by_keyboard_and_headings_have_a_level(site: ModuleType, tmp_path: Path) -> None:
    page = tmp_path / "adr" / "one.html"
    page.parent.mkdir()
    page.write_text('<p class="caption" role="heading">a</p><pre>b</pre>')
    for _ in range(2):
        site.open_to_everybody(tmp_path)
        assert page.read_text() == '<p class="caption" role="heading" aria-level="2">a</p><pre tabindex="0">b</pre>'


def test_references_are_made_from_the_code(pages: dict[str, str]) -> None:
    assert "## coordinator report" in pages["reference/command-line.md"]
    assert "--connect-file" in pages["reference/command-line.md"].partition("## island-worker")[2]
    configuration = pages["reference/configuration.md"]
    assert "| `seed` | `int` | `0` |" in configuration
    assert "## `[evolution]`" in configuration
    assert "FieldInfo" not in configuration
