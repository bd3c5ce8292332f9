"""The configuration of a job: what files of earlier versions say is read where it means what is done now."""

import pytest
from pydantic import ValidationError

from atoll_core.config import JobConfig

RETIRED = {
    "space": {"fixed_terminals": False, "arguments": "any node"},
    "evolution": {"mutation_unit": "node", "crowding_distance": "live nodes", "ties_replace": True},
}


def test_options_that_are_gone_are_read_where_they_say_what_is_done_now() -> None:
    assert JobConfig.model_validate(RETIRED) == JobConfig()
    assert JobConfig.model_validate({"evolution": RETIRED["evolution"] | {"islands": 3}}).evolution.islands == 3


@pytest.mark.parametrize(
    ("group", "name", "value"),
    [
        ("space", "fixed_terminals", True),
        ("evolution", "mutation_unit", "list"),
        ("evolution", "constant_steps", "normal"),
        ("evolution", "misspelt", 1),
    ],
)
def test_other_values_of_them_are_refused(group: str, name: str, value: object) -> None:
    with pytest.raises(ValidationError, match=name):
        JobConfig.model_validate({group: {name: value}})
