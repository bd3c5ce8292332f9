"""Log lines hold their fields, whatever is in them."""

import json
import logging
import sys
import threading

import pytest

from atoll_core.logs import JsonLines, TextLines, about, configure, fields, fields_of, with_context


def record(message: str = "placed", **values: object) -> logging.LogRecord:
    made = logging.LogRecord("coordinator", logging.WARNING, "file", 1, message, None, None)
    made.__dict__.update(fields(**values))
    made.created = 0.0
    return made


def test_a_text_line_has_time_level_event_fields_and_logger() -> None:
    line = TextLines({"worker": "w0"}).format(record(job="a", term=3, epoch=None, seconds=1.23456))
    assert line == "1970-01-01T00:00:00.000Z WARNING placed worker=w0 job=a term=3 seconds=1.235 (coordinator)"


@pytest.mark.parametrize("value", ["two words", "a=b", 'say "it"', "line\nend", "", "\x1b[31m"])
def test_a_value_cannot_break_out_of_its_field(value: str) -> None:
    line = TextLines({}).format(record(name=value, last=1))
    assert line.isprintable()
    quoted = line.split("name=")[1].split(" last=1")[0]
    assert json.loads(quoted) == value


def test_a_json_line_is_one_object_with_the_same_contents() -> None:
    said = json.loads(JsonLines({"worker": "w0"}).format(record(job="a", term=3, text="θ\n", island=None)))
    assert said == {
        "worker": "w0", "job": "a", "term": 3, "text": "θ\n", "time": "1970-01-01T00:00:00.000Z", "level": "warning",
        "logger": "coordinator", "event": "placed",
    }  # fmt: skip


def test_lines_have_the_job_and_the_task_that_they_are_about() -> None:
    with about(job="a", task="refining"), about(task="t1", worker=None):
        inner = record(term=3)
        with_context(inner)
    with about(job="another"):  # as when another thread writes it
        assert json.loads(JsonLines({}).format(inner)).items() >= {"job": "a", "task": "t1", "term": 3}.items()
    assert "worker" not in fields_of(inner)
    assert fields_of(record(term=3)) == {"term": 3}


def test_a_lines_own_fields_go_before_its_context() -> None:
    with about(job="a"):
        assert fields_of(record(job="b"))["job"] == "b"


def test_threads_are_about_their_own_jobs() -> None:
    seen: list[dict[str, object]] = []

    def work() -> None:
        with about(job="b"):
            seen.append(fields_of(record()))

    with about(job="a"):
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        seen.append(fields_of(record()))
    assert seen == [{"job": "b"}, {"job": "a"}]


def test_a_field_cannot_pose_as_the_event() -> None:
    assert json.loads(JsonLines({}).format(record(event="done")))["event"] == "placed"


def test_an_exception_is_told_in_both() -> None:
    try:
        raise ValueError("here")
    except ValueError:
        broken = record()
        broken.exc_info = sys.exc_info()
    assert "ValueError: here" in TextLines({}).format(broken)
    assert "ValueError: here" in json.loads(JsonLines({}).format(broken))["exception"]


def test_what_is_below_the_level_is_not_logged(capsys: pytest.CaptureFixture[str]) -> None:
    root = logging.getLogger()
    before, level = root.handlers[:], root.level
    try:
        configure("json", "warning", worker="w9")
        logging.getLogger("x").info("quiet")
        logging.getLogger("x").warning("loud", extra=fields(job="a"))
    finally:
        root.handlers[:] = before
        root.setLevel(level)
    (line,) = capsys.readouterr().err.splitlines()
    said = json.loads(line)
    assert (said["event"], said["job"], said["worker"]) == ("loud", "a", "w9")
