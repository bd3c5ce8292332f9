"""The corpus of operation lists, the loops that are timed on it, and what is printed."""

import dataclasses
import json

import numpy as np
import pytest

from atoll_core.errors import DataError, UsageError
from atoll_core.expression.operators import ADD, ARITY, CONSTANT, MULTIPLY, SIN, VARIABLE
from atoll_island_worker.evolution.kernels.measured_rows import padded_rows
from atoll_island_worker.evolution.structures import empty_lists, empty_tape
from benchmarks.harness.record import Record
from benchmarks.kernels import __main__ as kernels
from benchmarks.kernels import speeds
from benchmarks.kernels.corpus import CORPUS, EPOCHS, SIZE, load_corpus, make_corpus, save_corpus
from benchmarks.kernels.loops import (
    differentiate_into,
    fitness_by_numpy,
    gradient_repeatedly,
    instructions,
    operator_tape,
    room_for,
)
from benchmarks.kernels.speeds import OperatorSpeed, Peak, Speed, parts_of, wrong
from benchmarks.peers.strogatz import PUBLISHED

SPEED = Speed(16, 25.2e6, 180e6, 10e6, 70e6, 30.0)


@pytest.fixture(scope="module")
def corpus():
    return load_corpus()


def test_the_corpus_has_a_thousand_lists_from_all_files_and_generations(corpus):
    assert corpus.code.shape == (SIZE, 32)
    assert corpus.names.tolist() == list(PUBLISHED)
    assert set(np.bincount(corpus.origin).tolist()) == {71, 72}
    assert np.unique(corpus.generation).tolist() == [100 * (epoch + 1) for epoch in range(EPOCHS)]
    assert corpus.inputs.shape == (14, 2, 16)


def test_the_lists_are_whole_and_acyclic(corpus):
    index = np.arange(32)
    arity = np.array(ARITY)[corpus.code]
    assert (arity[:, :7] == 0).all()
    assert (arity[:, 7:] > 0).all()
    assert (corpus.left[:, 7:] < index[7:]).all()
    assert (corpus.right[:, 7:] < index[7:]).all()
    assert (corpus.left[:, :7] < 2).all()


def test_the_corpus_is_measured_as_numpy_would(corpus):
    parts = parts_of(corpus, 16)
    assert sum(len(part.live) for part in parts) == SIZE
    assert wrong(parts) == 0
    assert wrong(parts_of(corpus, 40)[:2]) == 0


def test_a_wrong_fitness_is_noticed(corpus, monkeypatch):
    def off_by_one(fitness, lists, rows, room):
        fitness[:] = 1.0

    monkeypatch.setattr(speeds, "measure_into", off_by_one)
    assert wrong(parts_of(corpus, 16)) > SIZE / 2


def test_a_corpus_survives_its_file(corpus, tmp_path):
    save_corpus(corpus, tmp_path / "new" / "corpus.npz")
    again = load_corpus(tmp_path / "new" / "corpus.npz")
    for field in dataclasses.fields(corpus):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(corpus, field.name))


def test_what_is_no_corpus_is_said(tmp_path):
    with pytest.raises(DataError, match="check out the file anew"):
        load_corpus(tmp_path / "none.npz")
    (tmp_path / "some.npz").write_text("text")
    with pytest.raises(DataError, match="not a corpus"):
        load_corpus(tmp_path / "some.npz")
    (tmp_path / "part.npz").write_bytes(CORPUS.read_bytes()[:5000])
    with pytest.raises(DataError, match="not a corpus"):
        load_corpus(tmp_path / "part.npz")


def test_a_place_that_cannot_be_written_is_said(corpus, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="name another file with --corpus"):
        save_corpus(corpus, tmp_path / "file" / "corpus.npz")
    with pytest.raises(UsageError, match="name another file with --out"):
        Record("kernels", [], tmp_path / "file" / "figures.json").write()


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


def test_numpy_evaluates_live_nodes_alone(lists):
    program = instructions(lists, 0, empty_tape(6))
    assert [code for code, *_ in program] == [VARIABLE, CONSTANT, MULTIPLY, SIN, ADD]
    x = np.array([[0.0, 1.0]])
    assert fitness_by_numpy([program], x, np.array([1.5, 1.5])) == pytest.approx([np.sin(1.5) / 2])


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


def test_shares_are_of_the_machines_peak():
    limit = Peak(in_cache=9e9, in_registers=18e9)
    assert kernels.rows_table([SPEED], limit).splitlines()[1].split()[-2:] == ["1.0%", "2.0%"]
    row = kernels.operators_table([OperatorSpeed("sin", 128, 900e6, 90e6, 1.5)], limit).splitlines()[1].split()
    assert row == ["sin", "128", "0.90", "0.09", "1.5", "5.0%", "10.0%"]


def test_the_whole_benchmark_prints_and_writes(corpus, tmp_path, capsys):
    save_corpus(dataclasses.replace(corpus, names=corpus.names[:1]), tmp_path / "corpus.npz")
    words = ["--corpus", str(tmp_path / "corpus.npz"), "--rows", "32", "--operator", "+", "--repetitions", "1"]
    assert kernels.main([*words, "--out", str(tmp_path / "figures.json")]) == 0
    figures = json.loads((tmp_path / "figures.json").read_text("utf-8"))
    assert [each["rows"] for each in figures["by_rows"]] == [16, 32]
    assert figures["corpus"]["wrong"] == 0
    assert "multiply-adds" in capsys.readouterr().out


def test_making_a_corpus_needs_a_folder_with_the_files(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        kernels.main(["--make-corpus", "--corpus", str(tmp_path / "c.npz")])
    assert ended.value.code == 2
    assert "--data" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        kernels.main(["--make-corpus", "--corpus", str(tmp_path / "c.npz"), "--data", str(tmp_path)])
    assert ended.value.code == 2
    assert not (tmp_path / "c.npz").exists()


@pytest.mark.parametrize("text", ["", "a", "16,", "0", "-1"])
def test_other_rows_are_refused(text, capsys):
    with pytest.raises(SystemExit) as ended:
        kernels.main([f"--rows={text}"])
    assert ended.value.code == 2
    assert "numbers of rows such as" in capsys.readouterr().err


def test_a_corpus_is_made_of_searches(tmp_path, monkeypatch, capsys):
    """A shorter search of one small file, twice: the same lists."""
    x, y = np.meshgrid(np.linspace(0.5, 2.0, 8), np.linspace(-1.0, 1.0, 8))
    lines = [f"{a * np.sin(b):.17g},{a:.17g},{b:.17g}" for a, b in zip(x.flat, y.flat, strict=True)]
    (tmp_path / "lv1.csv").write_text("\n".join(["label,x,y", *lines]) + "\n")
    monkeypatch.setattr("benchmarks.kernels.corpus.EPOCHS", 1)
    one, two = (make_corpus(tmp_path, size=5, names=("lv1",)) for _ in range(2))
    assert one.code.shape == (5, 32)
    assert one.generation.tolist() == [100] * 5
    np.testing.assert_array_equal(one.constants, two.constants)
    np.testing.assert_array_equal(one.code, two.code)
    assert wrong(parts_of(one, 16)) == 0
    assert CORPUS.is_file()
    capsys.readouterr()
