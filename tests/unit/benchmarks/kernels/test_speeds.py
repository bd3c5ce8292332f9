"""The corpus of operation lists, the loops that are timed on it, and what is printed."""

import dataclasses
import json

import numpy as np
import pytest

from atoll_core.errors import DataError
from atoll_core.expression.operators import ADD, ARITY, CONSTANT, MULTIPLY, SIN, VARIABLE
from atoll_island_worker.evolution.kernels.measured_rows import padded_rows
from atoll_island_worker.evolution.structures import empty_lists
from benchmarks.kernels import __main__ as kernels
from benchmarks.kernels import speeds
from benchmarks.kernels.corpus import CORPUS, load_corpus
from benchmarks.kernels.loops import differentiate_into, gradient_repeatedly, operator_tape, room_for
from benchmarks.kernels.speeds import Speed, parts_of
from benchmarks.peers.strogatz_files import NAMES

SPEED = Speed(16, 25.2e6, 180e6, 10e6, 70e6)


@pytest.fixture(scope="module")
def corpus():
    return load_corpus()


def test_the_corpus_has_a_thousand_lists_from_all_files_and_generations(corpus):
    assert corpus.code.shape == (1000, 32)
    assert corpus.names.tolist() == list(NAMES)
    assert set(np.bincount(corpus.origin).tolist()) == {71, 72}
    assert np.unique(corpus.generation).tolist() == [100 * (epoch + 1) for epoch in range(10)]
    assert corpus.inputs.shape == (14, 2, 16)


def test_the_lists_are_whole_and_acyclic(corpus):
    index = np.arange(32)
    arity = np.array(ARITY)[corpus.code]
    assert (arity[:, :7] == 0).all()
    assert (arity[:, 7:] > 0).all()
    assert (corpus.left[:, 7:] < index[7:]).all()
    assert (corpus.right[:, 7:] < index[7:]).all()
    assert (corpus.left[:, :7] < 2).all()


def test_what_is_no_corpus_is_said(tmp_path):
    with pytest.raises(DataError, match="check out the file anew"):
        load_corpus(tmp_path / "none.npz")
    (tmp_path / "some.npz").write_text("text")
    with pytest.raises(DataError, match="not a corpus"):
        load_corpus(tmp_path / "some.npz")
    (tmp_path / "part.npz").write_bytes(CORPUS.read_bytes()[:5000])
    with pytest.raises(DataError, match="not a corpus"):
        load_corpus(tmp_path / "part.npz")


def test_live_sizes_are_known_on_any_number_of_rows(corpus):
    parts = parts_of(corpus, 40)
    assert sum(len(part.live) for part in parts) == 1000
    assert sum(part.live.sum() for part in parts) / 1000 == pytest.approx(7.23, abs=0.01)
    assert {part.rows.length for part in parts} == {40}


@pytest.fixture
def lists():
    """Return one list: sin(1.5 * x) + 1.5, with a dead node."""
    lists = empty_lists(1, 6)
    lists.code[0] = [VARIABLE, CONSTANT, MULTIPLY, ADD, SIN, ADD]
    lists.left[0] = [0, 0, 1, 0, 2, 4]
    lists.right[0] = [0, 0, 0, 2, 0, 1]
    lists.constants[0, 1] = 1.5
    return lists


def test_the_gradient_is_that_of_the_mathematics(lists):
    x, fitness = np.linspace(-1.0, 1.0, 16), np.zeros(1)
    rows = padded_rows(x[None], np.zeros(16))
    room = room_for(6, rows)
    differentiate_into(fitness, lists, rows, room)
    assert fitness[0] == pytest.approx(np.abs(np.sin(1.5 * x) + 1.5).mean())
    np.testing.assert_allclose(room.work.adjoints[1], x * np.cos(1.5 * x) + 1.0)


def test_every_node_of_an_operator_tape_is_worked_on():
    rows = padded_rows(np.full((2, 16), 0.5), np.zeros(16))
    room = room_for(12, rows)
    count = operator_tape(SIN, 10, room.tape)
    gradient_repeatedly(1, count, rows, room)
    assert count == 12
    np.testing.assert_allclose(room.work.values[2:12], np.sin(0.5))
    np.testing.assert_allclose(room.work.adjoints[0], np.cos(0.5))


def test_the_fastest_repetition_counts(monkeypatch):
    """A clock that only calls turn on: 0.02 s for the first repetition that is timed, then 0.03, then 0.01."""
    clock = iter([0.0, 0.02, 1.0, 1.03, 2.0, 2.01])
    monkeypatch.setattr(speeds.time, "thread_time", lambda: next(clock))
    calls = []
    assert speeds.fastest(calls.append, 2) == pytest.approx(0.01)
    assert calls == [1, 1, 1, 1]


def test_a_quick_loop_is_repeated_until_it_can_be_timed(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(speeds.time, "thread_time", lambda: now[0])

    def call(times):
        now[0] += times * 1e-5

    assert speeds.fastest(call, 3) == pytest.approx(1e-5)


def test_the_goals_stand_beside_the_speed():
    text = kernels.corpus_text(1000, 7.226, SPEED)
    assert "mean live size 7.23" in text
    assert "25.2 M point evaluations/s, 0.18 G node evaluations/s (goals 100 M and 1.4 G)" in text
    assert "2.0 times a processor of the paper" in text


def test_the_whole_benchmark_prints_and_writes(corpus, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(kernels, "load_corpus", lambda: dataclasses.replace(corpus, names=corpus.names[:1]))
    words = ["--rows", "32", "--operator", "+", "--repetitions", "1", "--out", str(tmp_path / "figures.json")]
    assert kernels.main(words) == 0
    figures = json.loads((tmp_path / "figures.json").read_text("utf-8"))
    assert [measured["rows"] for measured in figures["by_rows"]] == [16, 32]
    assert "16 rows, from list to fitness" in capsys.readouterr().out
