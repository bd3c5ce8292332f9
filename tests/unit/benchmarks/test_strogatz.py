"""The Strogatz label files: what must be there, and the table beside the paper's."""

import dataclasses

import pytest

from benchmarks.strogatz import PUBLISHED, beside_the_paper, is_solved, main, truths
from common.errors import DataError
from tests.unit.benchmarks.verdicts import VERDICT

FILES = [f"{name}.csv" for name in PUBLISHED]


@pytest.fixture
def folder(tmp_path):
    for name in FILES:
        (tmp_path / name).write_text("label,x,y\n1,2,3\n")
    (tmp_path / "truth.json").write_text('{"glider1": "x"}')
    return tmp_path


def test_the_truths_are_read(folder):
    assert truths(folder) == {"glider1": "x"}


@pytest.mark.parametrize("missing", ["truth.json", "vdp2.csv"])
def test_a_missing_file_is_named(folder, missing):
    (folder / missing).unlink()
    with pytest.raises(DataError, match=missing):
        truths(folder)


def test_without_the_files_there_is_one_sentence_and_exit_code_2(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--data", str(tmp_path)])
    assert ended.value.code == 2
    assert "truth.json" in capsys.readouterr().err


def test_the_published_sums_are_those_of_the_paper():
    seconds, evaluations = (sum(column) for column in zip(*PUBLISHED.values(), strict=True))
    assert seconds == pytest.approx(589.7, abs=1.0)
    assert evaluations == pytest.approx(59.6e9, rel=0.01)


@pytest.mark.parametrize(("error", "solved"), [(9e-5, True), (1.1e-4, False), (None, False)])
def test_the_error_decides_what_is_solved(error, solved):
    assert is_solved(dataclasses.replace(VERDICT, error=error, exact=False)) is solved


def test_evaluations_stand_beside_the_papers():
    (_, row) = beside_the_paper([dataclasses.replace(VERDICT, case="lv2", point_evaluations=11_000_000)]).splitlines()
    assert row.split()[-2:] == ["1.10e+08", "0.1"]
