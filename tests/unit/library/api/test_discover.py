"""Keyword arguments mean what the options of ``run`` mean; a Ctrl-C keeps the best so far."""

import argparse
import contextlib
import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from atoll.api import discover
from atoll.api import discover as session
from atoll.api.discover import config_of
from atoll.cli.parser import build_parser, parse
from atoll.cli.request import config_of as configure
from atoll_core.errors import AtollError, RefusedError, UsageError
from atoll_core.wire.messages.views import JobView
from tests.unit.library.model.results import result


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, []),
        ({"seed": 3, "robust": True, "stochastic": False, "target": None}, ["--seed", "3", "--robust"]),
        ({"states": ["x", "y"], "inputs": "u"}, ["--states", "x,y", "--inputs", "u"]),
        ({"known": {"dx": "-x"}, "guess": ["dy=x", "dy=-x"]}, ["--known=dx=-x", "--guess=dy=x", "--guess=dy=-x"]),
        ({"operators": ["+", "-"], "max_time": 90}, ["--operators=+,-", "--max-time", "90"]),
        ({"operators": {"x": ["+", "*"]}, "allow": {"x": ["x", "y"]}}, ["--operators=x=+,*", "--allow=x=x,y"]),
        ({"bound": ["c > 0", "x: x*y < 0"]}, ["--bound=c > 0", "--bound=x: x*y < 0"]),
        (
            {"bound": {"x": ["c > 0", "|c| < 5"], "y": "c < 1"}},
            ["--bound=x:c > 0", "--bound=x:|c| < 5", "--bound=y:c < 1"],
        ),
        ({"require": {"x": ["y", "z"]}, "unit": {"x": "m/s"}}, ["--require=x=y,z", "--unit=x=m/s"]),
        ({"group": "strain"}, ["--group", "strain"]),
        ({"per_trajectory": True}, ["--per-trajectory"]),
        ({"max_epochs": {"x": 20, "y": 12}, "angle": "a:deg"}, ["--max-epochs", "x=20,y=12", "--angle=a:deg"]),
        ({"max_epochs": np.int64(7), "target_error": np.float64(0.5)}, ["--max-epochs", "7", "--target-error", "0.5"]),
        ({"guess": {"dx": ["x", "2*x"], "dy": 0}}, ["--guess=dx=x", "--guess=dx=2*x", "--guess=dy=0"]),
        ({"states": ["a,b", "c"]}, ["--states", '"a,b",c']),
    ],
)
def test_keywords_are_the_options_of_run(options: dict, words: list[str]) -> None:
    assert config_of(options) == configure(parse(["run", "data", *words]))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"sead": 3}, "sead is not an option; see help(atoll.discover); did you mean 'seed'?"),
        ({"out": "folder"}, "out is not an option"),
        ({"seed": "x"}, "seed must be a whole number, but 'x' was given"),
        ({"seed": True}, "seed must be a whole number, but True was given"),
        ({"robust": "yes"}, "robust must be True or False, but 'yes' was given"),
        ({"time": ["t", "u"]}, "time must be text, but ['t', 'u'] was given"),
        ({"known": {"dx": ""}}, "known must be of the form dy=-x/10, but {'dx': ''} was given"),
        ({"max_size": 500}, "max_size must be less than or equal to 120, but 500 was given"),
        ({"order": 2, "target": "y"}, "order=2 and target exclude each other"),
        ({"config": 3}, "config must be the path of a job file, but 3 was given"),
    ],
)
def test_what_is_no_option_or_no_value_of_one_is_refused_in_the_words_of_python(options: dict, sentence: str) -> None:
    with pytest.raises(UsageError) as caught:
        config_of(options)
    assert str(caught.value).startswith(sentence)


def test_every_option_of_run_changes_the_job_or_is_refused() -> None:
    """None is taken and ignored: those that describe a job are in groups of their own, and a job file."""
    verbs = next(action for action in build_parser()._actions if isinstance(action, argparse._SubParsersAction))
    described = {"data", "search", "budget"}
    for group in verbs.choices["run"]._action_groups:
        for action in group._group_actions:
            if group.title not in described and action.option_strings and action.dest != "config":
                with pytest.raises(UsageError, match="is not an option"):
                    config_of({action.dest: True})


def test_a_page_is_written_by_the_model() -> None:
    with pytest.raises(UsageError, match=r"report is not an option; .* model.report\(path\)"):
        config_of({"report": True})


VIEW = JobView(
    job="j", name="data", state="running", seed=0, preset="default", submitted="", elapsed=1.0, workers=1,
    point_evaluations=0,
)  # fmt: skip


class Client:
    """Stands for a connection to a coordinator with one job, which has found `found` when it is cancelled."""

    def __init__(self, contents: dict[str, Any] | None) -> None:
        self.contents = contents
        self.is_cancelled = False

    def hand_in(self, *given: object) -> None:
        self.given = given

    def now(self) -> float:
        return 0.0

    def pause(self, _: float) -> None:
        pass

    def cancel_and_wait(self, _: str) -> JobView:
        self.is_cancelled = True
        return VIEW

    def status(self, _: str) -> JobView:
        return VIEW.model_copy(update={"state": "cancelled" if self.is_cancelled else "running"})

    def follow(self, *_: object) -> object:
        raise KeyboardInterrupt  # whenever the progress is looked at

    def result(self, _: str) -> dict[str, Any]:
        if self.contents is None:
            raise RefusedError("nothing was found yet")
        return self.contents


@pytest.mark.parametrize("has_found", [True, False])
def test_an_interrupt_ends_the_job_and_keeps_the_best_so_far(
    has_found: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    client = Client(result({"x": "-x"}) if has_found else None)

    @contextlib.contextmanager
    def connected(*_: object) -> Iterator[Client]:
        yield client

    monkeypatch.setattr(discover, "connected", connected)
    table = {"t": [0.0, 1.0], "x": [1.0, 2.0]}
    if has_found:
        assert str(discover.discover(table, connect="tcp/h:1")) == "dx/dt = -x"
    else:
        with pytest.raises(KeyboardInterrupt):
            discover.discover(table, connect="tcp/h:1")
    assert client.is_cancelled
    assert client.given[-1] == 0
    assert capsys.readouterr().err == ""


def test_a_priority_goes_with_the_job_and_a_wrong_one_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    client = Client(None)
    monkeypatch.setattr(discover, "connected", lambda *_: contextlib.nullcontext(client))
    table = {"t": [0.0, 1.0], "x": [1.0, 2.0]}
    discover.submit(table, connect="tcp/h:1", priority=-3)
    assert client.given[-1] == -3
    for wrong in (11, -11, 0.5, True, "2"):
        with pytest.raises(UsageError, match="priority must be a whole number from -10 to 10, but"):
            discover.submit(table, connect="tcp/h:1", priority=wrong)  # type: ignore[arg-type]


def test_who_is_interrupted_while_a_job_is_handed_in_learns_its_id(monkeypatch: pytest.MonkeyPatch) -> None:
    class Impatient(Client):
        def hand_in(self, *given: object) -> None:
            self.given = given
            raise KeyboardInterrupt

    client = Impatient(None)
    monkeypatch.setattr(discover, "connected", lambda *_: contextlib.nullcontext(client))
    with pytest.raises(KeyboardInterrupt) as caught:
        discover.submit({"t": [0.0, 1.0], "x": [1.0, 2.0]}, connect="tcp/h:1")
    (note,) = caught.value.__notes__
    assert note.endswith(f"coordinator status {client.given[0]} --connect tcp/h:1")


class Service:
    """Stands for a process with its workers."""

    def __init__(self, workers: int) -> None:
        self.endpoint = f"tcp/{workers}"
        self.is_alive = True
        self.reason = ""

    def close(self) -> None:
        self.is_alive = False


@pytest.fixture(autouse=True)
def services(monkeypatch: pytest.MonkeyPatch) -> dict[int, Service]:
    kept: dict[int, Service] = {}
    monkeypatch.setattr(session, "LocalService", Service)
    monkeypatch.setattr(session, "_services", kept)
    return kept


def test_another_number_of_workers_does_not_end_the_service_of_a_call(services: dict[int, Service]) -> None:
    assert session.local_address(1) == "tcp/1"
    assert session.local_address(2) == "tcp/2"
    assert session.local_address(None) == session.local_address(1) == "tcp/1"
    assert all(service.is_alive for service in services.values())
    running = [*services.values()]
    session.close()
    assert not any(service.is_alive for service in running)
    assert services == {}


def test_a_service_that_has_ended_is_told_and_replaced(services: dict[int, Service]) -> None:
    address = session.local_address(3)
    session.check_service(address)
    services[3].is_alive = False
    with pytest.raises(AtollError, match="has ended: it was killed; the next call"):
        session.check_service(address)
    services[3].reason = "a child was lost"
    with pytest.raises(AtollError, match="has ended: a child was lost"):
        session.check_service(address)
    assert session.local_address() == f"tcp/{session.usable_cores(os.environ)[0]}"
    session.check_service(address)


@pytest.mark.parametrize("workers", [0, -1, 1.5, "a", 100_000])
def test_a_number_of_workers_that_cannot_be_is_refused(workers: object, services: dict[int, Service]) -> None:
    with pytest.raises(UsageError, match="whole number"):
        session.local_address(workers)  # type: ignore[arg-type]
    assert not services
