"""What holds for every test: arithmetic accidents are errors unless a test says otherwise."""

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from tests.certificates import HAS_OPENSSL, Lab

# Started in the background (``nohup``, ``&`` in a script) this process ignores signals that tests send, and processes
# that it starts inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)
for _number in (signal.SIGTERM, signal.SIGHUP):
    signal.signal(_number, signal.SIG_DFL)

# Six thousand tests are read by every worker, and the programs by every process: both once, then as bytecode.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

os.environ.pop("ATOLL_TRY_SETTINGS", None)  # tests are of the settings in use, whoever starts them

settings.register_profile("repeatable", deadline=None, derandomize=True, database=None)
settings.load_profile("repeatable")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add folders of what is not part of the checkout."""
    parser.addoption("--strogatz", type=Path, help="folder with the 14 Strogatz files, to search them as well")
    parser.addoption("--site", type=Path, help="folder of the built documentation, to look at it in a browser as well")


@pytest.fixture(autouse=True)
def _accidents_are_errors() -> Iterator[None]:
    with np.errstate(all="raise", under="ignore"):
        yield


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """Certificates of a lab: a coordinator, workers lab1 and lab2, submitters ann and bob, an admin, a router."""
    if not HAS_OPENSSL:
        pytest.skip("openssl is not there to make certificates")
    names = ("--worker", "lab1", "--worker", "lab2", "--submitter", "ann", "--submitter", "bob", "--admin", "eve")
    site = ("--router", "site=site.example")
    return Lab.make(tmp_path_factory.mktemp("tls") / "lab", "--coordinator", "lab.example", *names, *site)


@pytest.fixture(scope="session")
def other_lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """Certificates of somebody else's authority, with the same names."""
    if not HAS_OPENSSL:
        pytest.skip("openssl is not there to make certificates")
    return Lab.make(tmp_path_factory.mktemp("tls") / "other", "--coordinator", "lab.example", "--submitter", "ann")
