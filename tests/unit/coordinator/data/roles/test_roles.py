"""The role and the symbol of each column, units in headers, and messages for contradicting options."""

import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from sympy.parsing.sympy_parser import parse_expr

from atoll_coordinator.data.roles.names_and_options import are_units, strip_units
from atoll_coordinator.data.roles.roles import Roles, assign_roles, assign_symbols
from atoll_core.config import Angle, DataConfig
from atoll_core.errors import DataError, UsageError
from tests.unit.coordinator.data.tables import table_of


def roles(names, **options):
    table = table_of({name: [0.0, 1.0] for name in names.split()}, skipped=("who",))
    return assign_roles(table, DataConfig(**options))[0]


@pytest.mark.parametrize(
    ("names", "options", "expected"),
    [
        ("t x y", {}, Roles("t", None, ("x", "y"), ())),
        ("x time y", {}, Roles("time", None, ("x", "y"), ())),
        ("t time x", {}, Roles("t", None, ("time", "x"), ())),
        ("year t x", {"time": "year"}, Roles("year", None, ("t", "x"), ())),
        ("t x y", {"states": ("y",)}, Roles("t", None, ("y",), ())),
        ("t x u", {"inputs": ("u",)}, Roles("t", None, ("x",), ("u",))),
        ("t x", {"inputs": ("t",)}, Roles("t", None, ("x",), ("t",))),
        ("t x", {"time": "t", "inputs": ("t",)}, Roles("t", None, ("x",), ("t",))),
        ("trajectory t x", {}, Roles("t", "trajectory", ("x",), ())),
        ("run t x", {"trajectory": "run"}, Roles("t", "run", ("x",), ())),
        ("trajectory t x", {"states": ("trajectory", "x")}, Roles("t", None, ("trajectory", "x"), ())),
        ("label x y", {"target": "label"}, Roles(None, None, (), ("x", "y"), target="label")),
        ("t label x", {"target": "label"}, Roles(None, None, (), ("x",), target="label")),
        ("t label", {"target": "label"}, Roles(None, None, (), ("t",), target="label")),
        ("t label x", {"target": "label", "inputs": ("t",)}, Roles(None, None, (), ("t",), target="label")),
        ("label x y", {"target": "label", "states": ("y",)}, Roles(None, None, (), ("y",), target="label")),
        ("x dx", {"derivatives": ("dx",)}, Roles(None, None, ("x",), (), derivatives=("dx",))),
        (
            "t dy dx x y u",
            {"states": ("x", "y"), "derivatives": ("dx", "dy"), "inputs": ("u",)},
            Roles("t", None, ("x", "y"), ("u",), derivatives=("dx", "dy")),
        ),
    ],
)
def test_every_column_gets_its_role(names, options, expected):
    assert roles(names, **options) == expected


def test_columns_may_be_named_with_their_units():
    config = DataConfig(
        time="t [s]", states=("v [m/s]",), inputs=("u [N]",), only=("v [m/s]",), angles=(Angle(column="v [m/s]"),)
    )
    numbered = strip_units(DataConfig(trajectory="run [1]", holdout="run [1]=4"), ("t", "run"))
    assert (numbered.trajectory, numbered.holdout) == ("run", "run=4")
    plain = strip_units(config, ("t", "v", "u [N]"))
    assert plain == DataConfig(time="t", states=("v",), inputs=("u [N]",), only=("v",), angles=(Angle(column="v"),))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": "x", "derivatives": ("y",)}, "target and derivatives exclude each other"),
        ({"target": "x", "holdout": 1}, "holdout and target exclude each other"),
        ({"target": "x", "order": 2}, "order=2 and target exclude each other"),
        ({"derivatives": ("x",), "order": 2}, "order=2 and derivatives exclude each other"),
        ({"states": ("x", "y"), "inputs": ("y",)}, "column 'y' is named by both states and inputs; name it once"),
        ({"states": ("x", "x")}, "states names 'x' twice; name it once"),
        ({"target": "x", "inputs": ("x",)}, "column 'x' is named by both inputs and target"),
        ({"time": "x", "states": ("x",)}, "column 'x' is named by both states and time"),
        ({"trajectory": "x", "inputs": ("x",)}, "column 'x' is named by both inputs and trajectory"),
        ({"states": ("x", "y"), "derivatives": ("z",)}, "2 states and 1 derivatives were named"),
        ({"derivatives": ("z",)}, "1 derivatives were named for the states x, y"),
        ({"only": ("z",), "states": ("x",)}, "--only names 'z', but equations are searched for x"),
        ({"angles": (Angle(column="t"),)}, "--angle names 't', which is neither a state nor an input"),
        ({"target": "x", "angles": (Angle(column="x"),)}, "--angle names 'x', the target of an explicit regression"),
    ],
)
def test_contradictory_options_are_refused(options, message):
    with pytest.raises(UsageError) as raised:
        roles("t x y z", **options)
    assert message in str(raised.value)


@pytest.mark.parametrize(
    ("names", "options", "message"),
    [
        ("t alpha beta", {"states": ("alfa",)}, "which has t, alpha, beta; did you mean 'alpha'?"),
        ("t x", {"inputs": ("wind",)}, "there is no column 'wind' in a.csv, which has t, x"),
        ("t x", {"states": ("who",)}, "column 'who' holds text; a column of numbers is expected"),
        ("x y", {}, "no time column was found (looked for t or time); name it with --time (perhaps x), or give"),
        ("t", {}, "to be a state besides 't'; add one for each state"),
        ("t x x_dot", {"order": 2}, "'x_dot' is a state and with --order 2 also the name of the velocity of 'x'"),
        ("x", {"target": "x"}, "there is no column besides 'x' from which it could be computed"),
    ],
)
def test_columns_that_are_not_there_are_refused(names, options, message):
    with pytest.raises(DataError) as raised:
        roles(names, **options)
    assert message in str(raised.value)


def test_columns_of_text_may_be_meant_as_groups():
    table = table_of({"t": [0.0, 1.0], "x": [0.0, 1.0]}, skipped=("strain",))
    with pytest.raises(DataError, match=r"which has t, x, and with text strain; did you mean 'strain'\?"):
        assign_roles(table, DataConfig(group="stran"))


@pytest.mark.parametrize(("rows", "is_named"), [(8, True), (3, False)])
def test_a_time_that_begins_anew_is_named_with_what_it_needs(rows, is_named):
    """Two sites one after the other; three rows are no trajectory."""
    table = table_of({"week": [*range(rows), *range(rows)], "x": [1.0, 0.0] * rows})
    with pytest.raises(DataError) as raised:
        assign_roles(table, DataConfig())
    assert ("(perhaps week; it restarts: add --trajectory COLUMN, or blank rows)" in str(raised.value)) == is_named


def assert_parsed_back(symbols):
    """Every symbol, in an expression with our functions, is read by sympy as itself."""
    names = list(symbols.values())
    local = {name: sympy.Symbol(name) for name in names}
    text = " + ".join(f"2.5*{name}*sin({name})/cos({name})**2" for name in names)
    assert parse_expr(text, local_dict=local).free_symbols == set(local.values())


def test_identifiers_stay_as_they_are():
    names = ("S", "I", "N", "E", "O", "Q", "beta", "gamma", "zeta", "θ", "x_1", "t", "pi", "re", "oo")
    symbols = assign_symbols(names)
    assert symbols == {name: name for name in names}
    assert_parsed_back(symbols)


def test_keywords_functions_and_other_texts_are_rewritten():
    symbols = assign_symbols(["lambda", "sin", "v/w", "2nd", "x y", "", "%", "Float", "None"])
    assert symbols["lambda"] == "lambda_"
    assert symbols["sin"] == "sin_"
    assert symbols["v/w"] == "v_w"
    assert symbols["2nd"] == "x2nd"
    assert_parsed_back(symbols)


def test_rewritten_names_keep_out_of_the_way_of_others():
    symbols = assign_symbols(["x y", "x_y", "x-y", "lambda", "lambda_"])
    assert symbols["x_y"] == "x_y"
    assert symbols["lambda_"] == "lambda_"
    assert len(set(symbols.values())) == 5


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.lists(st.text(max_size=6), min_size=1, max_size=4, unique=True))
def test_any_names_get_unique_symbols_that_are_parsed_back(names):
    symbols = assign_symbols(names)
    assert list(symbols) == names
    assert len(set(symbols.values())) == len(names)
    assert_parsed_back(symbols)


UNITS = "s|m/s|m s^-2|m·s⁻²|°C|µg/mL|1/min|mol/(L h)|kg*m**2|%|years|W/m2|hPa|mg/dL"
OTHERS = "zero|two|1.5|1e5|x1||t=0|a rather long remark on a column|north"


def test_products_of_powers_of_known_symbols_are_units():
    assert [text for text in UNITS.split("|") if not are_units([text])] == []
    assert [text for text in OTHERS.split("|") if are_units([text])] == []


def test_beside_a_known_unit_others_may_stand():
    assert are_units(["years", "pelts"])
    assert not are_units(["s", "1.5"])
