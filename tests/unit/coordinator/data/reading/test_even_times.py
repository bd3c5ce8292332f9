"""Times that an option tells, and advice that helps: what it points to is not what fails next."""

import re
import shlex

import pytest

from atoll.cli.parser import parse
from atoll.cli.request import config_of
from atoll_coordinator.data.outline import describe
from atoll_coordinator.data.reading.files import read_table
from atoll_core.errors import DataError, UsageError


def test_rows_may_be_a_step_apart(read):
    table = read("x\n5\n6\n8\n\n1\n2\n", step=0.5)
    assert (table.names, table.columns.tolist()) == (("t", "x"), [[0, 0.5, 1, 0, 0.5], [5, 6, 8, 1, 2]])
    assert table.read_as == "text with commas; times 't' in steps of 0.5"


def test_each_trajectory_begins_at_0(read):
    table = read("run,x\na,5\na,6\nb,8\nb,1\nb,2\n", step=2.0, trajectory="run", time="clock")
    assert (table.names, table.column("clock").tolist()) == (("clock", "run", "x"), [0, 2, 0, 2, 4])


def test_a_step_beside_a_time_is_refused(read):
    with pytest.raises(UsageError, match=r"step 0\.5 gives the time between rows, but a\.csv has a time column, 't'"):
        read("t,x\n0,1\n1,2\n", step=0.5)


LINES = {
    "rows without a time": "x,y\n" + "".join(f"{row * row % 7},{row * row % 5}\n" for row in range(12)),
    "one column that ascends": "x\n" + "".join(f"{row}.5\n" for row in range(12)),
    "a time of another name": "clock,x\n" + "".join(f"{row},{row * row}\n" for row in range(12)),
    "a few missing values": "t,x\n" + "".join(f"{row},{row * row if row % 5 else ''}\n" for row in range(12)),
    "a state with two values": "t,x,y\n" + "".join(f"{row},{row**2},{row if row < 2 else ''}\n" for row in range(12)),
    "a constant state": "t,x,y\n" + "".join(f"{row},{row * row},3\n" for row in range(12)),
}
OPTION = re.compile(r"(--time|--states|--missing|--step|--inputs)( \(perhaps (\S+)\)| ([\w.,]*\w))?")


@pytest.mark.parametrize("kind", LINES)
def test_advice_does_not_point_to_what_fails_next(kind, tmp_path):
    (tmp_path / "a.csv").write_text(LINES[kind])
    with pytest.raises(DataError) as raised:
        seen(tmp_path, [])
    advice = str(raised.value).rpartition(";")[2]
    found = [(name, perhaps or value) for name, _, perhaps, value in OPTION.findall(advice)]
    assert found
    for name, value in found:
        words = {"--states": value or "x", "--inputs": value or "y"}.get(name, value)
        seen(tmp_path, [name, words])


def seen(folder, words):
    config = config_of(parse(["run", str(folder / "a.csv"), *shlex.split(" ".join(words))]))
    return describe(read_table([folder / "a.csv"], config.data), config)


def test_what_no_option_helps_with_says_so(tmp_path):
    for text, advice in (
        (
            "t,k\n" + "".join(f"{row},3\n" for row in range(12)),
            "(3 in every row); add a column that varies",
        ),
        ("t\n" + "".join(f"{row}\n" for row in range(12)), "to be a state besides 't'; add one for each state"),
        ("t,x\n" + "".join(f"{row},{row if row < 2 else ''}\n" for row in range(12)), "'x' has 2 values in 12 rows"),
    ):
        (tmp_path / "a.csv").write_text(text)
        with pytest.raises(DataError) as raised:
            seen(tmp_path, [])
        assert advice in str(raised.value)
        assert "--" not in str(raised.value)
