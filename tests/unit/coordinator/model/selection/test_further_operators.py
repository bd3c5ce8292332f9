"""Operators with which no search begins: tried where none are named, taken where the description is shorter."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.selection.model_selection import operator_remarks
from atoll_core.config import BASE_OPERATORS, JobConfig, SpaceConfig
from atoll_core.data.notes import Note
from tests.unit.coordinator.model.selection.begun import looked_again, selected
from tests.unit.coordinator.model.shooting.made import Known

NAMED = JobConfig(space=SpaceConfig(operators=BASE_OPERATORS))
TANK = Known(("h",), lambda _, z: [0.5 - np.sqrt(z[0])])
DECAY = Known(("h",), lambda _, z: [0.5 - z[0]])


def remarks(selection):
    return list(operator_remarks(selection, dict(zip(selection.task.variables, selection.model.programs, strict=True))))


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_function_that_makes_the_description_shorter_is_taken_and_named(noise):
    found = looked_again("further operators", selected(TANK, "0.45 - 1.6*h/(0.7 + h) - 0.15*h", noise))
    assert TANK.text(found.model.programs[0]).count("sqrt") == 1
    assert found.comparison.score.is_exact(found.model) == (noise == 0.0)
    (sentence,) = remarks(found)
    assert "with sqrt the description is shorter" in sentence
    assert isinstance(sentence, Note)


@pytest.mark.parametrize("begun", ["0.4 - 0.9*h", "0.3 - 0.1*h*h"])
def test_a_law_is_taken_whatever_errors_the_equation_before_it_left(begun):
    found = looked_again("further operators", selected(TANK, begun))
    assert found.comparison.score.is_exact(found.model), TANK.text(found.model.programs[0])


def test_operators_that_are_named_are_kept_to():
    selection = selected(TANK, "0.45 - 1.6*h/(0.7 + h) - 0.15*h", config=NAMED)
    assert looked_again("further operators", selection) is selection
    assert remarks(selection) == []


def test_operators_of_one_equation_are_kept_to():
    config = JobConfig(space=SpaceConfig(operators_of={"h": BASE_OPERATORS}))
    selection = selected(TANK, "0.45 - 1.6*h/(0.7 + h) - 0.15*h", config=config)
    assert looked_again("further operators", selection) is selection


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_law_without_them_stays_as_it_is(noise):
    selection = selected(DECAY, "0.4 - 0.9*h", noise)
    widened = looked_again("further operators", selection)
    assert widened.model is selection.model
    assert list(widened.widened) == (["h"] if noise else [])
    assert remarks(widened) == []


def test_that_they_were_tried_in_vain_is_said_where_something_is_left():
    selection = selected(TANK, "0.4 - 0.9*h")
    assert remarks(selection) == []
    (sentence,) = remarks(replace(selection, widened=["h"]))
    assert "exp, log, sqrt, abs, tanh, pow were tried as well" in sentence
    assert isinstance(sentence, Note)
