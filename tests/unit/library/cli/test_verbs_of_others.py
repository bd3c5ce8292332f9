"""Every verb that asks a coordinator, asked as another user: a private job is as if there were none, and only its
submitter changes it. A verb that is added needs its words here."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from atoll.cli.adapt import BatchError, BatchJobs
from atoll.cli.doctor import check_coordinator
from atoll.cli.main import main
from atoll.cli.options import VERBS
from atoll_coordinator.service.store.store import Store
from atoll_core.wire.bus.interface import Event, Reply
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.clients import Answer, ClientRequest
from atoll_core.wire.messages.handshake import GreetingAnswer, Welcome
from tests.unit.coordinator.service.requests.test_users import Lab

JOB: Final = "JOB"
ASKED: Final[dict[str, tuple[str, ...]]] = {
    "submit": ("DATA",), "ping": (), "jobs": (), "workers": ("--coordinator",), "logs": (JOB,),
    "adapt": ("--maximum", "1"), "doctor": (), "status": (JOB,), "cancel": (JOB,),
    "delete": (JOB,), "pause": (JOB,), "resume": (JOB,),
    "priority": (JOB, "3"), "share": (JOB,), "retry": (JOB, "--id", "again"), "cordon": ("lab1",),
    "uncordon": ("lab1",), "drain": ("lab1",), "queue": ("pause",), "result": (JOB,),
    "simulate": (JOB,), "analyse": (JOB,), "report": (JOB,), "suggest": (JOB,), "compare": (JOB, JOB),
    "export": (JOB, "--format", "python"),
}  # fmt: skip
"""The words of each verb; without `JOB` it is one that names no job."""

ASKS_NOTHING: Final[dict[str, tuple[str, ...]]] = {"schema": (), "completion": ("bash",)}
SERVES: Final = {"run", "serve", "web", "router", "backup", "restore"}
"""Verbs that are, or copy, a coordinator."""

CHANGES: Final = {"cancel", "delete", "pause", "resume", "priority", "share", "retry"}
OF_ADMINS: Final = {"cordon", "uncordon", "drain", "queue"}
MOST: Final = 40
"""Questions after which a verb that goes on for ever is interrupted."""


class Line:
    """A bus on which a lab answers a user; virtual time passes only while nothing is there to receive."""

    def __init__(self, lab: Lab, user: str) -> None:
        self._lab, self._user = lab, user
        self._events: list[Event] = []
        self._now = 0.0
        self.asked = 0

    def subscribe(self, key_expression: str) -> None:
        """Nothing is told."""

    def get(self, key: str, payload: bytes = b"", timeout_s: float = 5.0) -> int:
        self.asked += 1
        if self.asked > MOST:
            raise KeyboardInterrupt
        if "/hello/" in key:
            welcome = Welcome(realm="r1", incarnation=1, protocol=1, version="0.1.0", engine=1)
            answer = encode(GreetingAnswer(body=welcome))
        else:
            asked = decode(payload, ClientRequest)
            answer = encode(Answer.model_validate({"body": self._lab.ask(self._user, asked.body)}))
        self._events.append(Reply(self.asked, answer))
        return self.asked

    def receive(self, timeout_s: float) -> Event | None:
        if self._events:
            return self._events.pop(0)
        self._now += timeout_s
        return None

    def now(self) -> float:
        return self._now


@pytest.fixture
def lab() -> Iterator[Lab]:
    """Ann has a private job, and one that is shared."""
    with Store.open(None) as store:
        lab = Lab(store)
        lab.submit("ann", "mine", b"mine")
        lab.submit("ann", "shared", b"shared", shared=True)
        lab.controller.events.flush()
        yield lab


class Terminal:
    """Runs verbs as bob, and keeps what they print."""

    def __init__(self, lab: Lab, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self._lab, self._folder, self._capsys = lab, folder, capsys
        (folder / "DATA").write_text("t,x\n" + "".join(f"{n},{0.9**n}\n" for n in range(40)))
        self.lines: list[Line] = []

    @contextlib.contextmanager
    def line(self, *_: object, **__: object) -> Iterator[Line]:
        self.lines.append(Line(self._lab, "bob"))
        yield self.lines[-1]

    def run(self, verb: str, words: tuple[str, ...], job: str) -> tuple[int, str]:
        given = [job if word == JOB else str(self._folder / word) if word == "DATA" else word for word in words]
        code = main([verb, *given, *(["--connect", "tcp/127.0.0.1:1"] if verb not in ASKS_NOTHING else [])])
        printed = self._capsys.readouterr()
        return code, printed.out + printed.err


def no_batch_system(_: BatchJobs) -> str:
    raise BatchError("there is no batch system")


@pytest.fixture
def terminal(lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Terminal:
    made = Terminal(lab, tmp_path, capsys)
    monkeypatch.setattr("atoll.cli.doctor.check_address", lambda _: ())
    monkeypatch.setattr("atoll.cli.doctor.CHECKS", (check_coordinator,))
    monkeypatch.setattr("atoll_core.wire.bus.zenoh_bus.open_client", made.line)
    monkeypatch.setattr(BatchJobs, "jobs", lambda _: ())
    monkeypatch.setattr(BatchJobs, "submit", no_batch_system)
    monkeypatch.setattr("time.sleep", lambda _: None)
    monkeypatch.chdir(tmp_path)
    return made


def test_every_verb_is_asked_here_or_an_entrance_of_its_own() -> None:
    assert set(VERBS) == {*ASKED, *ASKS_NOTHING, *SERVES}
    assert {verb for verb, words in ASKED.items() if JOB not in words} >= OF_ADMINS
    assert {verb for verb, words in ASKED.items() if JOB in words} >= CHANGES


@pytest.mark.parametrize("verb", ASKED)
def test_a_private_job_of_another_user_is_as_if_there_were_none(lab: Lab, terminal: Terminal, verb: str) -> None:
    before = lab.store.job("mine")
    code, said = terminal.run(verb, ASKED[verb], "mine")
    assert sum(line.asked for line in terminal.lines) > 0, "a coordinator was asked"
    if JOB in ASKED[verb]:
        assert (code, said.replace("mine", "none")) == terminal.run(verb, ASKED[verb], "none")
        assert code == 2
    else:
        assert "mine" not in said
    assert lab.store.job("mine") == before


@pytest.mark.parametrize("verb", sorted(CHANGES | OF_ADMINS))
def test_what_another_user_shares_and_what_is_all_users_is_not_changed(lab: Lab, terminal: Terminal, verb: str) -> None:
    before = lab.store.jobs()
    code, said = terminal.run(verb, ASKED[verb], "shared")
    assert code == 2
    assert ("only ann or an admin may" if verb in CHANGES else "only an admin may") in said
    assert (lab.store.jobs(), lab.store.is_queue_paused(), lab.store.cordons()) == (before, False, {})


@pytest.mark.parametrize("verb", ASKS_NOTHING)
def test_what_asks_nothing_asks_nothing(terminal: Terminal, verb: str) -> None:
    assert terminal.run(verb, ASKS_NOTHING[verb], "mine")[0] == 0
    assert terminal.lines == []
