"""What `run` and `submit` ask for."""

from pathlib import Path

import pytest

from atoll.cli.request import Request
from atoll_core.config import BudgetConfig, JobConfig


@pytest.mark.parametrize(("gone", "left"), [(1.0, 9.0), (4.0, 6.0), (9.0, 5.0)])
def test_what_starting_took_counts_for_the_time_up_to_half_of_it(gone, left):
    request = Request("job", "name", JobConfig(budget=BudgetConfig(max_time=10.0)), (Path("a.csv"),), json=False)
    assert request.after(gone).config.budget.max_time == left


def test_a_job_without_a_limit_stays_without_one():
    request = Request("job", "name", JobConfig(), (Path("a.csv"),), json=False)
    assert request.after(3.0) is request
