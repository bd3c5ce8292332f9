"""Whatever is cut from a result or written into it: those who read it go on, or say in a sentence what is wrong."""

import copy
import json
from collections.abc import Callable, Iterator
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from atoll.api.model import Model
from atoll.text.render import render
from atoll_coordinator.result.result import Result
from atoll_core.errors import AtollError
from tests.unit.library.report.results import dynamics, process, regression

RESULTS = [json.loads(json.dumps(contents)) for contents in (dynamics(), regression(), process())]
PLACES = 2
"""Items of a list that are changed; the others are like these."""


def paths(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every part of a result."""
    parts = value.items() if isinstance(value, dict) else enumerate(value[:PLACES]) if isinstance(value, list) else ()
    for key, part in parts:
        yield (*path, key)
        yield from paths(part, (*path, key))


PATHS = [(number, path) for number, contents in enumerate(RESULTS) for path in paths(contents)]


def readers(contents: dict[str, Any]) -> Iterator[Callable[[], Any]]:
    yield lambda: render(Result.of(contents), "csv")
    yield lambda: render(Result.of(contents), "latex")
    yield lambda: Model(contents).summary()
    yield lambda: Model(contents)._repr_html_()
    yield lambda: [str(candidate) for candidate in Model(contents).candidates]
    yield lambda: Model(contents).export("python", t=[0.0, 1.0])


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(st.sampled_from(PATHS), st.sampled_from(["cut", "text", -3, [], {}]))
def test_who_reads_a_damaged_result_goes_on_or_says_what_is_wrong(place: tuple[int, Any], change: Any) -> None:
    number, path = place
    contents = copy.deepcopy(RESULTS[number])
    part: Any = contents
    for key in path[:-1]:
        part = part[key]
    if change == "cut":
        del part[path[-1]]
    else:
        part[path[-1]] = change
    for read in readers(contents):
        try:
            read()
        except AtollError as error:
            assert "\n" not in str(error)  # noqa: PT017  reading may succeed as well
