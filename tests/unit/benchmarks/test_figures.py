"""What README and documentation quote is what was measured, and every figure there is one that is measured again."""

import json
from pathlib import Path

import pytest

from atoll_core.errors import DataError
from benchmarks import figures
from benchmarks.figures import (
    MARK,
    PLAN,
    Campaign,
    Measurement,
    command,
    documents,
    load_figures,
    quoted,
    runs_of,
)

KEYS = {
    "figure", "runs", "seeds", "complete", "revision", "engine", "date", "processor", "cores", "load", "command",
}  # fmt: skip
PAGES = {page.name: page.read_text("utf-8") for page in documents()}


@pytest.mark.parametrize("page", PAGES)
def test_a_page_quotes_the_figures_of_the_file(page: str) -> None:
    known = load_figures()
    different = {
        mark["name"]: (mark["text"], known.get(mark["name"], {}).get("figure"))
        for mark in MARK.finditer(PAGES[page])
        if mark["text"] != known.get(mark["name"], {}).get("figure")
    }
    assert not different, f"run python -m benchmarks.figures quote, and read what moved: {different}"


@pytest.mark.parametrize("page", PAGES)
def test_no_mark_is_broken(page: str) -> None:
    assert PAGES[page].count("<!-- figure:") == len(MARK.findall(PAGES[page]))


def test_every_figure_says_how_it_was_measured() -> None:
    names = {measurement.name for measurement in PLAN}
    for name, entry in load_figures().items():
        assert set(entry) == KEYS, name
        assert name.split(".")[0] in names, f"{name} is measured by no benchmark of the plan"


def test_every_benchmark_of_the_plan_is_quoted() -> None:
    marked = {mark["name"].split(".")[0] for text in PAGES.values() for mark in MARK.finditer(text)}
    assert marked == {measurement.name for measurement in PLAN}


def test_figures_are_written_where_they_are_quoted() -> None:
    known = {"a.b": {"figure": "3 of 4"}}
    assert quoted("so <!-- figure: a.b -->1 of 2<!-- end -->.", known) == "so <!-- figure: a.b -->3 of 4<!-- end -->."
    with pytest.raises(DataError, match=r"no figure 'a[.]c'"):
        quoted("<!-- figure: a.c -->1<!-- end -->", known)


RUNS = {
    "table3": [{"exact": True, "search_seconds": 0.5}, {"exact": True, "search_seconds": 0.012}, {"exact": False}],
    "race": [{"ours": 0.1, "peers": 1.0}, {"ours": None, "peers": 12.0}],
    "labels": [{"srbench": True, "strict": True}, {"srbench": False, "strict": True}],
    "beside": [{"equations": [{"t": 9.0, "form": "right"}, {"t": None, "form": "other"}, {"t": 1.0, "form": "other"}]}],
    "verdicts": [
        {
            "equations": [
                {"t": 9.0, "form": "right", "grade": "exact", "r2": 1.0},
                {"t": 9.0, "form": "extra", "grade": "good", "r2": 0.99},
                {"t": 9.0, "form": "other", "grade": "good", "r2": 0.1},
                {"t": 9.0, "form": "other", "grade": None, "r2": None},
            ]
        }
    ],
    "flows": [{"error": 0.001}, {"error": 0.02}, {"error": None}],
    "yeast": [{"forms": ["right", "other"]}, {"forms": ["right"]}],
}
EXPECTED = {
    "table3": {"found": "2 of 3", "seconds": "0.012 to 0.5 s"},
    "race": {"met": "1 of 2", "seconds": "1.1 s", "operon": "2 of 2", "ratio": "0.32"},
    "labels": {"right": "1 of 2", "strict": "2 of 2"},
    "beside": {"right": "1 of 2"},
    "verdicts": {"good": "1 of 2", "exact": "1 of 1", "right": "1 of 4"},
    "flows": {"right": "1 of 3"},
    "yeast": {"right": "2 of 3"},
}


@pytest.mark.parametrize("name", EXPECTED)
def test_figures_follow_from_runs(name: str) -> None:
    (measurement,) = (measurement for measurement in PLAN if measurement.name == name)
    assert measurement.figures(RUNS[name]) == EXPECTED[name]


def test_a_file_of_lines_is_gone_on_with_and_read_up_to_its_last_whole_line(tmp_path: Path) -> None:
    out = tmp_path / "runs.jsonl"
    (measurement,) = (measurement for measurement in PLAN if measurement.name == "yeast")
    assert command(measurement, "1-2", out, {})[-4:] == ["--seeds", "1-2", "--out", str(out)]
    out.write_text('{"head": {}}\n{"outcome": {"forms": []}}\n{"outco')
    assert command(measurement, "1-2", out, {})[-2:] == ["--resume", str(out)]
    assert runs_of(out) == [{"forms": []}]
    assert runs_of(tmp_path / "none.json") == []


def test_a_measurement_is_written_at_once_and_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (measurement,) = (measurement for measurement in PLAN if measurement.name == "yeast")
    monkeypatch.setattr(figures, "FOLDER", tmp_path)

    def benchmark(words: list[str], limit_s: float | None) -> None:
        count = 2 if limit_s is None else 1
        Path(words[-1]).write_text(count * '{"outcome": {"forms": ["right"]}}\n')

    monkeypatch.setattr(figures, "run", benchmark)
    campaign = Campaign({}, "abc", tmp_path / "figures.json", {})
    assert campaign.measure(measurement, "1-2", 5.0) == ["yeast: ended after 1 runs"]
    assert not campaign.has(measurement, "1-2")
    assert campaign.measure(measurement, "1-2", None) == []
    written = json.loads(campaign.file.read_text("utf-8"))
    assert (written["yeast.right"]["figure"], set(written["yeast.right"])) == ("2 of 2", KEYS)
    assert campaign.has(measurement, "1-2")
    assert not campaign.has(measurement, "2")
    empty = Measurement("flows", "", "", "", 2, (1.0, 1.0), lambda _: {"right": "0 of 0"}, resumes="--out")
    assert campaign.measure(empty, "", None) == []
    assert "flows.right" not in campaign.known
    assert not Campaign({}, "abd", campaign.file, written).has(measurement, "1-2")
