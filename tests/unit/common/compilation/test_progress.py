"""Sentences on how many kernels are compiled, and how they are shown."""

import io
import sys

import pytest

from atoll_core.compilation.progress import WarmUpDisplay, count_of, sentence_of


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_sentence_gives_back_its_count() -> None:
    assert count_of(sentence_of(3, 13)) == (3, 13)
    assert count_of("waiting while another process of this machine compiles the kernels") is None


def test_without_a_terminal_the_first_and_the_last_are_written(capsys: pytest.CaptureFixture[str]) -> None:
    show = WarmUpDisplay()
    for done in range(4):
        show(sentence_of(done, 3), "for the worker")
    show("waiting")
    first, last = sentence_of(0, 3), sentence_of(3, 3)
    assert capsys.readouterr().err == f"for the worker: {first}\nfor the worker: {last}\nwaiting\n"


def test_on_a_terminal_there_is_a_bar_for_each_warm_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    show = WarmUpDisplay()
    for done in range(3):
        show(sentence_of(done, 2), "for the worker")
        show(sentence_of(done, 2), "for the coordinator")
    drawn = sys.stderr.getvalue()  # type: ignore[attr-defined]
    assert all(text in drawn for text in ("for the worker", "for the coordinator", "50%", "100%"))
