"""Left-hand sides as people write them."""

import pytest

from atoll_coordinator.data.prior_knowledge import LeftSides
from atoll_core.errors import UsageError

SYMBOLS = {"x": "x", "v-x": "v_x", "dx": "dx", "u": "u"}


def sides(order=1, variables=("x", "v-x")):
    return LeftSides(variables, SYMBOLS, order)


@pytest.mark.parametrize("text", ["x", "dx", "dx/dt", "dx/dtime", "x'", " x ", "x [m]"])
def test_first_derivatives_are_written_in_many_ways(text):
    assert sides().variable("--known", text) == "x"


@pytest.mark.parametrize("text", ["x", "d2x", "d2x/dt2", "d2x/dt^2", "d2x/dt**2", "d2x/dyear2", "x''"])
def test_second_derivatives_are_written_in_many_ways(text):
    assert sides(2).variable("--known", text) == "x"


@pytest.mark.parametrize("text", ["v-x", "v_x", "dv-x", "dv_x/dt", "v_x'"])
def test_a_column_may_be_named_by_its_symbol(text):
    assert sides().variable("--known", text) == "v-x"


def test_a_column_comes_before_the_derivative_that_its_name_looks_like():
    both = sides(variables=("x", "dx"))
    assert both.variable("--known", "dx") == "dx"
    assert both.variable("--known", "dx/dt") == "x"
    assert both.variable("--known", "ddx/dt") == "dx"


@pytest.mark.parametrize(
    ("order", "text", "words"),
    [
        (1, "d2x", ["'d2x'", "second derivative", "--order 2"]),
        (2, "dx/dt", ["'dx/dt'", "first derivative", "d2x", "--order 2"]),
        (None, "dx", ["'dx'", "x", "as it stands"]),
        (1, "z", ["--known", "'z'", "x, v-x"]),
        (1, "dz/dt", ["'dz/dt'"]),
        (1, "", ["''"]),
    ],
)
def test_what_belongs_to_no_equation_is_refused(order, text, words):
    with pytest.raises(UsageError) as caught:
        sides(order).variable("--known", text)
    assert [word for word in words if word not in str(caught.value)] == []


def test_everything_for_one_equation_comes_together_in_the_order_of_the_equations():
    by_side = {"dv_x": 1, "x'": 2, "v-x": 3}
    assert list(sides().several("--guess", by_side).items()) == [("x", (2,)), ("v-x", (1, 3))]
    with pytest.raises(UsageError, match="--allow names the equation of 'v-x' twice"):
        sides().single("--allow", by_side)


def test_variables_are_named_by_column_or_symbol():
    assert sides().symbols_of("--allow", ("u", "v-x", "v_x", "x [m]")) == ("u", "v_x", "x")
    for texts, words in ((("w",), "'w', but the variables are x, v-x, dx, u"), ((), "no variable")):
        with pytest.raises(UsageError, match=words):
            sides().symbols_of("--allow", texts)
