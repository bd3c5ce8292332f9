"""Keyword arguments mean what the options of ``run`` mean."""

import pytest

from atoll.errors import UsageError
from atoll_coordinator.api.discover import config_of
from atoll_coordinator.cli.options.job_config import job_config
from atoll_coordinator.cli.options.parser import parse


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, []),
        ({"seed": 3, "robust": True, "stochastic": False, "target": None}, ["--seed", "3", "--robust"]),
        ({"states": ["x", "y"], "inputs": "u"}, ["--states", "x,y", "--inputs", "u"]),
        ({"known": {"dx": "-x"}, "guess": ["dy=x", "dy=-x"]}, ["--known=dx=-x", "--guess=dy=x", "--guess=dy=-x"]),
        ({"operators": ["+", "-"], "max_time": 90}, ["--operators=+,-", "--max-time", "90"]),
        ({"operators": {"x": ["+", "*"]}, "allow": {"x": ["x", "y"]}}, ["--operators=x=+,*", "--allow=x=x,y"]),
        ({"max_epochs": {"x": 20, "y": 12}, "angle": "a:deg"}, ["--max-epochs", "x=20,y=12", "--angle=a:deg"]),
    ],
)
def test_keywords_are_the_options_of_run(options: dict, words: list[str]) -> None:
    assert config_of(options) == job_config(parse(["run", "data", *words]))


@pytest.mark.parametrize("options", [{"sead": 3}, {"seed": "x"}, {"out": "folder"}, {"json": True}])
def test_what_is_no_option_is_refused(options: dict) -> None:
    with pytest.raises(UsageError):
        config_of(options)
