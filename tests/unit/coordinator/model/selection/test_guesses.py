"""A user's guess is fitted along the trajectories and listed, whatever the search thinks of it."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.selection.alternatives import rank_alternatives
from atoll_coordinator.model.selection.candidates import CandidateSet, form_key
from atoll_coordinator.model.selection.model_selection import try_guesses
from tests.unit.coordinator.model.selection.begun import selected
from tests.unit.coordinator.model.shooting.made import Known

GROWTH = Known(("h",), lambda _, z: [1.5 * z[0] - 0.5 * z[0] ** 2])
TRUTH = "1.5*h - 0.5*h*h"


def guessing(text, *guesses, noise=0.02):
    """Return what is selected when the equation `text` is all that there is beside guesses."""
    selection = selected(GROWTH, text, noise)
    given = CandidateSet(guesses=tuple(map(GROWTH.parsed, guesses)))
    return replace(selection, task=replace(selection.task, candidates={"h": given}))


@pytest.mark.parametrize("guess", ["0.3*h", "0.1 - 0.2*h*h", "2.0*sin(h)"])
def test_a_guess_that_is_far_behind_is_listed_with_its_nats(guess):
    selection = guessing(TRUTH, guess)
    (alternatives,) = rank_alternatives(selection, selection.task.dataset.inputs).alternatives
    (listed,) = [one for one in alternatives if form_key(one.model.programs[0]) == form_key(GROWTH.parsed(guess))]
    assert 10.0 < listed.model.nats - selection.model.nats < np.inf


def test_a_guess_is_listed_behind_as_many_alternatives_as_are_kept():
    selection = guessing(TRUTH, "-0.001*h*h*h")
    for power in range(2, 20):
        selection.comparison.narrow_down(
            selection.model, 0, [GROWTH.parsed(f"1.5*h - 0.5*h*h + 0.01*cos({power}*h)")], ((1, 1),)
        )
    (alternatives,) = rank_alternatives(selection, selection.task.dataset.inputs).alternatives
    assert form_key(alternatives[-1].model.programs[0]) == form_key(GROWTH.parsed("-0.001*h*h*h"))
    assert len(alternatives) > 1


def test_a_guess_that_describes_the_data_in_fewer_nats_is_the_model_whatever_constants_it_was_written_with():
    selection = guessing("0.3*h", "7.0*h*(1.0 - h/2.0)")
    assert try_guesses(selection).model.nats < selection.model.nats - 10.0
    assert form_key(try_guesses(selection).model.programs[0]) in {
        form_key(GROWTH.parsed(text)) for text in (TRUTH, "h*(3-h)")
    }


def test_a_guess_that_is_no_better_changes_nothing():
    selection = guessing(TRUTH, "0.3*h")
    assert try_guesses(selection) is selection


def test_a_guess_has_its_origin_also_where_the_search_has_it():
    guess = GROWTH.parsed(TRUTH)
    given = CandidateSet(runners_up=(guess,), guesses=(guess,))
    assert given.origins(())[form_key(guess)] == "guess"
