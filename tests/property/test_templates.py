"""What must hold of every template: any text is read or refused with a sentence, and homes of unknown parts differ."""

import math
import struct

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from atoll_coordinator.data.prior_knowledge import resolve_prior
from atoll_core.config import JobConfig, ParameterConfig, PriorConfig
from atoll_core.errors import UsageError
from atoll_core.expression.program import tree_size
from atoll_core.expression.template import TemplateParameter, read_template
from atoll_core.expression.text.infix import PRINTABLE_SIZE, to_infix
from tests.oracles.evaluate import evaluate
from tests.property.programs import ROWS, programs

QUICK = settings(max_examples=400, deadline=None, derandomize=True, database=None)
NAMES = ("x", "y", "theta")
PIECES = st.sampled_from([
    "?", "?1", "?2", "?(x)", "?1(x,y)", "?()", "? (", "x", "y", "theta", "c", "k1", "lambda", "e5", "π", "ʔ", "2", "2e",
    "0.5", "1e3", ".5", "+", "-", "*", "/", "**", "**2", "(", ")", " ", ",", "sin", "sin(", "exp(", "tan(", "pi", "=",
    "^", "é", "\N{COMBINING ACUTE ACCENT}", "\n", "𝑥", "",
])  # fmt: skip
TEXTS = st.one_of(st.lists(PIECES, max_size=12).map("".join), st.text(max_size=20))


@QUICK
@given(
    st.dictionaries(st.sampled_from(NAMES), TEXTS, max_size=3), st.lists(st.sampled_from(["c", "x", "q"]), max_size=2)
)
def test_any_text_is_read_or_refused_with_one_sentence(sides, declared):
    parameters = {name: ParameterConfig(lower=0.5) for name in declared}
    config = JobConfig(prior=PriorConfig(equations=sides, parameters=parameters))
    symbols = {name: name for name in NAMES}
    try:
        resolved = resolve_prior(config, NAMES, symbols)
    except UsageError:
        return
    assert resolve_prior(resolved, NAMES, symbols) == resolved
    template = read_template(sides, {name: TemplateParameter(name) for name in declared}, NAMES)
    homes = [unknown.home for unknown in template.unknowns]
    assert len(set(homes)) == len(homes)
    assert all(unknown.home in unknown.equations for unknown in template.unknowns)


@QUICK
@given(st.lists(st.tuples(st.sampled_from(NAMES), st.integers(1, 3)), min_size=1, max_size=7, unique=True))
def test_every_unknown_part_has_a_home_if_there_is_any_assignment(occurrences):
    sides = {}
    for name, number in occurrences:
        sides[name] = f"{sides.get(name, 'x')} + ?{number}"
    labels = sorted({number for _, number in occurrences})
    where = [{name for name, other in occurrences if other == number} for number in labels]
    if not any_assignment(where, set()):
        with pytest.raises(UsageError, match="more unknown parts than equations"):
            read_template(sides, {}, NAMES)
        return
    template = read_template(sides, {}, NAMES)
    assert {unknown.label for unknown in template.unknowns} == {f"?{number}" for number in labels}


def any_assignment(where, taken):
    """Tell by trying all whether each set can give an element that no other gives."""
    if not where:
        return True
    return any(any_assignment(where[1:], taken | {name}) for name in where[0] - taken)


@QUICK
@given(programs(), programs(largest=8), programs(largest=8), ROWS)
def test_a_composed_side_has_the_value_of_the_side_with_the_value_of_its_unknown_part(side, slot, other, row):
    """The three inputs of `side` are a variable, a parameter and an unknown part, which depends on the variables."""
    assume(tree_size(side) <= PRINTABLE_SIZE)
    text = to_infix(side, ("x", "a", "?1"))
    try:
        template = read_template({"x": text, "y": "?1"}, {}, NAMES).for_equations(("x", "y"))
    except UsageError:  # too long
        return
    x, value = row[0], row[1]
    values = np.full(len(template.parameters), value)
    slots = (slot, other) if template.unknowns[0].home == "x" else (other, slot)
    composition = template.compose(slots, values)
    expected = evaluate(side, (x, value, evaluate(slot, row)))
    assert bits(evaluate(composition.programs[0], row)) == bits(expected)
    assert bits(evaluate(composition.programs[1], row)) == bits(evaluate(slot, row))
    for places in composition.parameters:
        assert all(composition.programs[one].constants[node] == value for one, node in places)


def bits(value):
    return b"nan" if math.isnan(value) else struct.pack("<d", value)
