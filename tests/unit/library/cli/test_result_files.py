"""The files of a result in its folder."""

import json
from pathlib import Path

import pytest

from atoll.cli.result_files import refuse_existing_result, write_result
from atoll_core.errors import UsageError


def test_a_result_is_written_once_and_never_over_another(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    path = write_result(folder, {"job": "one", "symbol": "θ"})
    with pytest.raises(UsageError, match="exists already"):
        write_result(folder, {"job": "two"})
    assert json.loads(path.read_text("utf-8")) == {"job": "one", "symbol": "θ"}
    with pytest.raises(UsageError, match="exists already"):
        refuse_existing_result(folder)


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(UsageError, match="is a file"):
        refuse_existing_result(tmp_path / "out")
    with pytest.raises(UsageError, match="cannot be written"):
        write_result(tmp_path / "out" / "deeper", {})
