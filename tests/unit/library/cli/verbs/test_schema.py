"""The schema of job files says what the configuration takes, that of results is the file of the package."""

import json

import pytest

from atoll.cli.main import main
from atoll_coordinator.result.result import schema_text
from atoll_core.config import DataConfig, JobConfig


def test_the_schema_has_every_setting_with_its_description(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert set(printed["properties"]) == set(JobConfig.model_fields)
    assert printed["additionalProperties"] is False
    data = printed["$defs"]["DataConfig"]["properties"]
    assert set(data) == set(DataConfig.model_fields)
    assert "time column" in data["time"]["description"]


def test_the_schema_of_results_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", "result"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(schema_text())
