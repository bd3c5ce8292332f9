"""What the tests of reading share."""

import pytest

from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig


@pytest.fixture
def read(tmp_path):
    """Write one file, of text or bytes, and return the table that is read from it."""

    def write_and_read(text, name="a.csv", **options):
        (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_table([tmp_path / name], DataConfig(**options))

    return write_and_read
