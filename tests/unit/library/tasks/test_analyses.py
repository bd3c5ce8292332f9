"""Questions about results: a worker's answer is the one that a saved result gives, to the bit."""

import json

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.experiments.designs import DesignRequest
from atoll.tasks.analyses import (
    FUNCTIONS,
    AnalyseDynamics,
    Profile,
    Question,
    Report,
    Suggest,
    analyse,
    answer,
    answered,
)
from atoll_coordinator.model.batches import FUNCTIONS as BATCHES
from atoll_coordinator.model.batches import Spread
from atoll_coordinator.result.result import Result
from atoll_core.errors import RefusedError
from atoll_core.wire.values import encode_value
from tests.unit.library.experiments.made import measured
from tests.unit.library.model.results import result

TIMES = np.linspace(0.0, 5.0, 20)
DECAY = 3.0 * np.exp(-0.6 * TIMES) + 0.02 * np.random.default_rng(1).standard_normal(20)
RESULT = Result.of(measured({"x": "0.1 - 0.6*x"}, [(TIMES, {"x": DECAY})], 0.02))


class Helpers:
    """Compute batches from bytes, as other workers do."""

    workers = 3
    threads = 1

    def map(self, function: str, context: bytes, items: list[bytes], cancel_after: float | None = None) -> list[bytes]:
        return [BATCHES[function](context, item) for item in items]

    def note(self, compared: int) -> None:
        pass


@pytest.mark.parametrize(
    "question",
    [
        AnalyseDynamics(box={"x": (0.0, 4.0)}),
        Profile(form="json"),
        Suggest(request=DesignRequest({}, samples=9), form="json"),
        Report(pictures=True),
    ],
    ids=lambda question: FUNCTIONS[type(question)],
)
def test_a_worker_answers_as_a_saved_result_does(question: Question) -> None:
    made = analyse(
        FUNCTIONS[type(question)], RESULT.to_json().encode(), encode_value(question), None, Spread(Helpers())
    )
    assert answered(made) == answer(RESULT, question)


LORENZ = result({"x": "10.0*(y - x)", "y": "x*(28.0 - z) - y", "z": "x*y - 2.667*z"})


@pytest.mark.slow
def test_the_parts_of_a_chaotic_analysis_are_the_same_on_workers() -> None:
    box = {"x": (-40.0, 40.0), "y": (-50.0, 50.0), "z": (0.0, 75.0)}
    question = AnalyseDynamics(box=box, vary=("c1", (9.0, 11.0)), form="json")
    alone = answer(Result.of(LORENZ), question)
    assert answer(Result.of(LORENZ), question, None, Spread(Helpers())) == alone
    assert json.loads(alone.text)["lyapunov"]["is_chaotic"]


def test_experiments_that_tell_rivals_apart_are_the_same_on_workers() -> None:
    question = Suggest(request=DesignRequest({"x": (0.1, 9.0)}, rivals=[{"x": "-0.5*x"}], samples=9), form="json")
    alone = answer(RESULT, question)
    assert answer(RESULT, question, None, Spread(Helpers())) == alone
    assert json.loads(alone.text)["purpose"] == "discrimination"


def test_what_does_not_fit_the_result_is_refused_in_a_sentence() -> None:
    question = encode_value(AnalyseDynamics(box={"z": (0.0, 1.0)}))
    with pytest.raises(RefusedError, match="the box has 'z'"):
        answered(analyse("analyse", RESULT.to_json().encode(), question, None))


def test_profiles_are_those_of_the_model() -> None:
    printed = json.loads(answer(RESULT, Profile(form="json")).text)
    assert printed == Model(RESULT).identifiability().as_dict()
