"""What `run` and `submit` ask for."""

from pathlib import Path

import pytest

from atoll.cli.options.parser import parse
from atoll.cli.request import Request, request_of
from atoll_core.config import BudgetConfig, JobConfig
from atoll_core.errors import UsageError


@pytest.mark.parametrize(("gone", "left"), [(1.0, 9.0), (4.0, 6.0), (9.0, 5.0)])
def test_what_starting_took_counts_for_the_time_up_to_half_of_it(gone, left):
    request = Request("job", "name", JobConfig(budget=BudgetConfig(max_time=10.0)), (Path("a.csv"),), json=False)
    assert request.after(gone).config.budget.max_time == left


def test_a_job_without_a_limit_stays_without_one():
    request = Request("job", "name", JobConfig(), (Path("a.csv"),), json=False)
    assert request.after(3.0) is request


def test_a_sheet_of_what_is_no_workbook_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    with pytest.raises(UsageError) as raised:
        request_of(parse(["run", str(tmp_path / "a.csv"), "--sheet", "run 1"]))
    assert raised.value.on_command_line == "--sheet names a sheet of an Excel workbook, but a.csv is none; leave it out"
    (tmp_path / "a.XLSX").write_text("")
    request = request_of(parse(["run", str(tmp_path / "a.csv"), str(tmp_path / "a.XLSX"), "--sheet", "run 1"]))
    assert request.config.data.sheet == "run 1"
