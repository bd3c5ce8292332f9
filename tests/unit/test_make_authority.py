"""The script that makes a lab's certificates: what it leaves behind, what it adds later, what it refuses."""

from pathlib import Path

import pytest

from atoll_core.wire.security.credentials import load
from atoll_core.wire.security.roles import read_role_bindings
from tests.certificates import Lab, make_authority


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, lab: Lab) -> Lab:
    """A lab of our own, to add to."""
    del lab  # skips where there is no openssl
    return Lab.make(tmp_path_factory.mktemp("made") / "tls", "--coordinator", "a.lab,10.0.0.5", "--worker", "lab1")


def test_only_the_owner_can_read_what_is_made(made: Lab) -> None:
    assert all(path.stat().st_mode & 0o077 == 0 for path in made.folder.rglob("*"))


def test_names_are_added_and_those_that_are_there_stay(made: Lab) -> None:
    before = made.files("lab1")[1].read_bytes()
    done = make_authority(made.folder, "--worker", "lab1", "--submitter", "ann", "--router", "site=b.lab")
    assert done.returncode == 0
    assert "worker lab1: there already" in done.stdout
    assert made.files("lab1")[1].read_bytes() == before
    roles = {"coordinator": "coordinator", "lab1": "worker", "ann": "submitter", "site": "router"}
    assert read_role_bindings(made.folder / "roster.toml").roles == roles
    assert load(*made.files("ann"), use="connect").name == "ann"
    assert "b.lab" in load(*made.files("site"), use="serve").hosts


def test_a_certificate_names_each_host_once(made: Lab) -> None:
    assert make_authority(made.folder, "--coordinator", "localhost,a.lab,127.0.0.1,10.0.0.5,a.lab").returncode == 0
    hosts = load(*made.files("coordinator"), use="serve").hosts
    assert sorted(hosts) == ["10.0.0.5", "127.0.0.1", "::1", "a.lab", "localhost"]


def test_a_certificate_is_renewed_on_demand(made: Lab) -> None:
    before = made.files("lab1")[2].read_bytes()
    assert make_authority(made.folder, "--renew", "lab1", "--days", "30").returncode == 0
    assert made.files("lab1")[2].read_bytes() != before
    assert load(*made.files("lab1"), use="connect").name == "lab1"


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--worker", "lab1-gpu"), "lab1 is there, and NAME-... are the processes of NAME"),
        (("--worker", "a b"), "1 to 48 letters"),
        (("--worker", "../x"), "1 to 48 letters"),
        (("--submitter", "lab1"), "the roster has it as worker"),
        (("--worker", "x", "--submitter", "x"), "given twice"),
        (("--worker", "authority"), "this name is taken"),
        (("--router", "r"), "NAME=HOST"),
        (("--coordinator", "a;b"), "neither a host name nor an address"),
        (("--renew", "nobody"), "does not have this name"),
        (("--days", "0", "--worker", "y"), "1 to 9999"),
        (("--worker",), "needs a value"),
        (("--boss", "z"), "unknown option --boss"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence_and_changes_nothing(
    options: tuple[str, ...], reason: str, made: Lab
) -> None:
    before = sorted(made.folder.iterdir())
    done = make_authority(made.folder, *options)
    assert done.returncode == 2
    assert reason in done.stderr
    assert sorted(made.folder.iterdir()) == before


def test_a_folder_of_something_else_is_not_touched(tmp_path: Path, lab: Lab) -> None:
    del lab
    (tmp_path / "notes").write_text("mine")
    done = make_authority(tmp_path, "--coordinator", "a")
    assert done.returncode == 2
    assert "holds no roster" in done.stderr
    assert make_authority(tmp_path / "new", "--worker", "w").returncode == 2
