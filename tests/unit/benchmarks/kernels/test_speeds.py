"""The corpus of operation lists, the loops that are timed on it, and the printed text."""

import dataclasses
import json

import pytest

from atoll_core.errors import DataError
from benchmarks.kernels import __main__ as kernels
from benchmarks.kernels.corpus import CORPUS, load_corpus


@pytest.fixture(scope="module")
def corpus():
    return load_corpus()


def test_what_is_no_corpus_is_said(tmp_path):
    with pytest.raises(DataError, match="check out the file anew"):
        load_corpus(tmp_path / "none.npz")
    (tmp_path / "some.npz").write_text("text")
    with pytest.raises(DataError, match="not a corpus"):
        load_corpus(tmp_path / "some.npz")
    (tmp_path / "part.npz").write_bytes(CORPUS.read_bytes()[:5000])
    with pytest.raises(DataError, match="not a corpus"):
        load_corpus(tmp_path / "part.npz")


def test_the_whole_benchmark_prints_and_writes(corpus, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(kernels, "load_corpus", lambda: dataclasses.replace(corpus, names=corpus.names[:1]))
    words = ["--rows", "32", "--operator", "+", "--repetitions", "1", "--out", str(tmp_path / "figures.json")]
    assert kernels.main(words) == 0
    figures = json.loads((tmp_path / "figures.json").read_text("utf-8"))
    assert [measured["rows"] for measured in figures["by_rows"]] == [16, 32]
    assert "16 rows, from list to fitness" in capsys.readouterr().out
