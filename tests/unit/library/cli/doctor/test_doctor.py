"""What the doctor finds, what it advises, and that nothing it looks at can break it."""

import json
import subprocess
import sys
from argparse import Namespace
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from atoll.cli import doctor
from atoll.cli import parser as arguments
from atoll.cli.doctor import Diagnosis, as_text, as_tree, check_data, fine
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.wire.addresses import destination
from atoll_core.wire.bus.zenoh_bus import ZenohBus, open_router
from atoll_core.wire.messages.handshake import Welcome
from atoll_core.wire.messages.views import WorkerView
from atoll_core.wire.security.credentials import load
from tests.certificates import Lab
from tests.unit.documents import ROOT

NOW = datetime(2026, 1, 1, tzinfo=UTC)
DATA = str(ROOT / "examples" / "lotka_volterra.csv")


@pytest.fixture(autouse=True)
def _no_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ATOLL_CONNECT", raising=False)


def options(*words: str) -> Namespace:
    return arguments.parse(["doctor", *words])


def grades(findings: Iterable[Diagnosis]) -> list[str]:
    return [finding.grade for finding in findings]


def worker(name: str, **changes: object) -> WorkerView:
    fields = {"host": "lab", "pid": 1, "state": "ready", "islands": 0, "silent": 0.2, "version": VERSION, "detail": ""}
    return WorkerView.model_validate({"worker": name, **fields, **changes})


def test_a_machine_in_order_ends_with_0_and_every_finding_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert doctor.doctor(options(DATA, "--state", str(tmp_path), "--listen", "tcp/127.0.0.1:0", "--json")) == 0
    tree = json.loads(capsys.readouterr().out)
    subjects = {finding["subject"] for finding in tree["findings"]}
    assert {"versions", "cores", "memory", "kernels", "state folder", "port", "coordinator", "data"} <= subjects
    assert tree["fine"] is True


def test_problems_end_with_1_and_each_says_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert doctor.doctor(options("missing.csv", "--connect", "tcp/127.0.0.1:9", "--listen", "tcp/192.0.2.1:1")) == 1
    out = capsys.readouterr().out
    assert out.count("PROBLEM") == 3
    assert out.count("-> ") >= 3
    assert "3 problems" in out.splitlines()[-1]


def test_text_and_json_say_the_same() -> None:
    findings = [fine("a", "one\ntwo"), Diagnosis("long", "warning", "three", "four")]
    assert as_text(findings).splitlines() == [
        "ok       a     one",
        "               two",
        "warning  long  three",
        "               -> four",
        "0 problems, 1 warning",
    ]
    tree = as_tree(findings)
    assert tree["fine"] is True
    assert tree["findings"][1] == {"subject": "long", "grade": "warning", "found": "three", "advice": "four"}  # type: ignore[index]


# ------------------------------------------------------------------------------------------- the machine


def test_memory_is_what_system_and_control_group_leave(tmp_path: Path) -> None:
    meminfo = tmp_path / "meminfo"
    meminfo.write_text("MemTotal: 100 kB\nMemAvailable: 50 kB\n")
    assert doctor.available_memory(meminfo, tmp_path) == 50 * 1024
    (tmp_path / "memory.max").write_text("30000\n")
    (tmp_path / "memory.current").write_text("10000\n")
    assert doctor.available_memory(meminfo, tmp_path) == 20000
    (tmp_path / "memory.max").write_text("max\n")
    assert doctor.available_memory(meminfo, tmp_path) == 50 * 1024
    assert doctor.available_memory(tmp_path / "none", tmp_path) is None


def test_kernels_are_compiled_or_can_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from atoll_core.compilation.cache import marker

    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    monkeypatch.setenv("ATOLL_KERNEL_CACHE", str(tmp_path))
    (before,) = doctor.check_kernels(options())
    assert (before.grade, "not compiled yet" in before.found) == ("fine", True)
    monkeypatch.setattr(doctor.os, "access", lambda *_: False)
    (locked,) = doctor.check_kernels(options())
    assert locked.grade == "problem"
    assert "ATOLL_KERNEL_CACHE" in locked.advice
    marker("atoll_island_worker").parent.mkdir()
    marker("atoll_island_worker").touch()
    (after,) = doctor.check_kernels(options())
    assert after.found.startswith("compiled")
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert grades(doctor.check_kernels(options())) == ["warning"]


def test_the_state_folder_must_have_room_and_may_not_be_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "new" / "state"
    assert grades(doctor.check_state(options("--state", str(place)))) == ["fine"]
    assert not place.parent.exists(), "nothing is made"
    for free, grade in ((500 * doctor.MB, "warning"), (5, "problem")):
        monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _, free=free: Namespace(free=free))
        assert grades(doctor.check_state(options("--state", str(place)))) == [grade]
    (tmp_path / "file").touch()
    assert grades(doctor.check_state(options("--state", str(tmp_path / "file")))) == ["problem"]


# ------------------------------------------------------------------------------------------- the network


@pytest.fixture
def router() -> Iterable[ZenohBus]:
    with open_router("tcp/127.0.0.1:0") as bus:
        yield bus


def test_a_port_in_use_is_a_problem_and_a_free_one_is_not(router: ZenohBus) -> None:
    (finding,) = doctor.check_listen(options("--listen", router.endpoint))
    assert finding.grade == "problem"
    assert "in use" in finding.found
    assert "--listen" in finding.advice
    assert grades(doctor.check_listen(options())) == []


def test_a_coordinator_in_order_is_greeted_and_its_workers_are_missed(router: ZenohBus, tmp_path: Path) -> None:
    import threading

    stop = threading.Event()
    with Store.open(tmp_path) as store:
        service = Service(router, store)
        service.start()
        loop = threading.Thread(target=service.work, args=(stop,))
        loop.start()
        try:
            findings = {
                finding.subject: finding for finding in doctor.check_coordinator(options("--connect", router.endpoint))
            }
        finally:
            stop.set()
            loop.join()
    assert {name: finding.grade for name, finding in findings.items()} == {
        "address": "fine", "coordinator": "fine", "clock": "fine", "workers": "warning",
    }  # fmt: skip
    assert VERSION in findings["coordinator"].found
    assert router.endpoint in findings["workers"].advice


def test_another_version_is_a_problem_for_workers() -> None:
    ours = Welcome(realm="r", incarnation=1, protocol=PROTOCOL_VERSION, version=VERSION, engine=ENGINE_REVISION)
    assert list(doctor.version_findings(ours)) == []
    (finding,) = doctor.version_findings(ours.model_copy(update={"version": "9.9"}))
    assert finding.grade == "problem"
    assert "9.9" in finding.advice


@pytest.mark.parametrize(("seconds", "grade"), [(0, "fine"), (4, "fine"), (-90, "warning"), (90, "warning")])
def test_clocks_are_compared(seconds: float, grade: str) -> None:
    (finding,) = doctor.clock_findings((NOW + timedelta(seconds=seconds)).isoformat(), NOW)
    assert finding.grade == grade
    assert ("ahead" in finding.found, "behind" in finding.found) == (seconds > 5, seconds < -5)


def test_workers_that_hang_or_are_not_ready_are_named() -> None:
    workers = [worker("a"), worker("b", silent=9.0), worker("c", state="compiling", detail="compiling kernels")]
    findings = list(doctor.worker_findings([*workers, worker("d", state="lost")], "tcp/a:1"))
    assert grades(findings) == ["fine", "warning", "fine"]
    assert findings[0].found == "3 on 1 machine"
    assert "b on lab has been silent for 9 s" in findings[1].found
    assert "compiling kernels" in findings[2].found


# ------------------------------------------------------------------------------------------------- data


def test_a_data_file_is_described_as_submit_would_take_it() -> None:
    (finding,) = check_data(options(DATA))
    assert finding.grade == "fine"
    assert "states: x, y" in finding.found
    (finding,) = check_data(options(DATA, "--states", "x"))
    assert "states: x" in finding.found
    assert list(check_data(options())) == []


def test_what_columns_say_is_a_warning(tmp_path: Path) -> None:
    file = tmp_path / "copied.csv"
    rows = [f"{row},{row**2 % 37},{row**2 % 37}" for row in range(30)]
    file.write_text("\n".join(["t,x,z", *rows]))
    described, warning = check_data(options(str(file)))
    assert (described.grade, warning.grade) == ("fine", "warning")
    assert "states: x" in described.found.splitlines()
    assert "'z' is x in every row" in warning.found
    assert "--states x,z" in warning.advice


def test_data_that_cannot_be_used_is_a_problem_with_the_readers_words(tmp_path: Path) -> None:
    file = tmp_path / "bad.csv"
    file.write_text("t,x\n0,1\n0,2\n0,3\n")
    (finding,) = check_data(options(str(file)))
    assert finding.grade == "problem"
    assert finding.found
    (finding,) = check_data(options(DATA, "--states", "nothing"))
    assert (finding.grade, "nothing" in finding.found) == ("problem", True)


# ------------------------------------------------------------------------------------------- certificates


def test_a_certificate_is_examined_before_anybody_is_dialled(lab: Lab, other_lab: Lab) -> None:
    (good,) = doctor.check_certificates(options(*lab.options("ann")))
    assert (good.grade, good.found.split(",")[0]) == ("fine", "of ann")
    (serving,) = doctor.check_certificates(options("--listen", "tls/0.0.0.0:0", *lab.options("coordinator")))
    assert "lab.example" in serving.found
    authority, certificate, key = other_lab.files("ann")[0], *lab.files("ann")[1:]
    words = ["--tls-ca", str(authority), "--tls-cert", str(certificate), "--tls-key", str(key)]
    (foreign,) = doctor.check_certificates(options(*words))
    assert (foreign.grade, "was not issued by the authority" in foreign.found) == ("problem", True)
    assert foreign.advice
    assert list(doctor.check_certificates(options())) == []


def test_a_certificate_that_expires_soon_is_pointed_out(lab: Lab) -> None:
    files = load(*lab.files("ann"), use="connect")
    assert files.expires is not None
    soon = doctor.certificate_finding(files, files.expires - 86400.0)
    assert soon.grade == "warning"
    assert "--renew ann" in soon.advice


def test_an_address_with_tls_and_no_certificate_is_a_problem(lab: Lab) -> None:
    with open_router(destination("tls/127.0.0.1:0", load(*lab.files("coordinator"), use="serve"))) as bus:
        findings = list(doctor.check_coordinator(options("--connect", bus.endpoint)))
    assert grades(findings) == ["fine", "problem"]
    assert "needs certificates" in findings[1].found


# ------------------------------------------------------------------------------------------------ quick


def test_a_quick_look_loads_nothing_heavy() -> None:
    code = (
        "import sys; from atoll.cli.main import main;"
        "assert main(['doctor', '--quick', '--connect', 'tcp/127.0.0.1:9']) == 1;"
        "heavy = {'numba', 'numpy', 'zenoh', 'pydantic', 'sympy'} & set(sys.modules);"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
