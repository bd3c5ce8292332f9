"""What holds for every test: arithmetic accidents are errors unless a test says otherwise."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the folder of data sets that are not part of the project."""
    parser.addoption("--strogatz", type=Path, help="folder with the 14 Strogatz files, to search them as well")


@pytest.fixture(autouse=True)
def _accidents_are_errors() -> Iterator[None]:
    with np.errstate(all="raise", under="ignore"):
        yield
