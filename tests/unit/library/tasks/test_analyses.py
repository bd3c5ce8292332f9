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


def test_what_does_not_fit_the_result_is_refused_in_a_sentence() -> None:
    question = encode_value(AnalyseDynamics(box={"z": (0.0, 1.0)}))
    with pytest.raises(RefusedError, match="the box has 'z'"):
        answered(analyse("analyse", RESULT.to_json().encode(), question, None))


def test_profiles_are_those_of_the_model() -> None:
    printed = json.loads(answer(RESULT, Profile(form="json")).text)
    assert printed == Model(RESULT).identifiability().as_dict()
