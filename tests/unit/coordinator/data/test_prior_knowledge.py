"""Prior knowledge in terms of the data, by left-hand sides as people write them."""

import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.prior_knowledge import LeftSides, known_programs, resolve_prior
from atoll_coordinator.tasks.defaults import resolve
from atoll_core.config import (
    BASE_OPERATORS,
    DataConfig,
    EvolutionConfig,
    JobConfig,
    ParameterConfig,
    PriorConfig,
    SpaceConfig,
)
from atoll_core.errors import UsageError
from atoll_core.expression.text.infix import to_infix
from tests.unit.coordinator.data.tables import oscillator, table_of

SYMBOLS = {"x": "x", "y-1": "y_1", "u": "u"}
VARIABLES = ("x", "y-1")


def config_of(guesses=(), known=(), operators_of=(), variables_of=(), required_of=(), bounds=(), **others):
    parameters = {name: ParameterConfig(**settings) for name, settings in others.pop("parameters", {}).items()}
    equations = others.pop("equations", {})
    space = SpaceConfig(
        operators_of=dict(operators_of), variables_of=dict(variables_of), required_of=dict(required_of),
        **others.pop("space", {}),
    )  # fmt: skip
    prior = PriorConfig(
        guesses=dict(guesses), known=dict(known), bounds=dict(bounds), equations=equations, parameters=parameters
    )
    return JobConfig(prior=prior, space=space, **others)


def resolved(variables=VARIABLES, **options):
    return resolve_prior(config_of(**options), variables, SYMBOLS)


def test_left_hand_sides_become_variables_and_allowed_columns_symbols():
    config = resolved(
        guesses={"dx/dt": ("2*x",), "x": ("y_1",)},
        known={"dy_1": "-x/10"},
        operators_of={"x'": ("+", "*")},
        variables_of={"dx": ("y-1", "x")},
    )
    assert config.prior == PriorConfig(guesses={"x": ("2*x", "y_1")}, known={"y-1": "-x/10"})
    assert config.space.operators_of == {"x": ("+", "*")}
    assert config.space.variables_of == {"x": ("y_1", "x")}
    assert resolve_prior(config, VARIABLES, SYMBOLS) == config


def test_an_equation_has_its_own_operators_and_variables_the_others_the_general_ones():
    space = resolved(operators_of={"x": ("+",)}, variables_of={"x": ("u", "x")}).space
    names = tuple(SYMBOLS.values())
    assert (space.operators_for("x"), space.operators_for("y-1")) == (("+",), BASE_OPERATORS)
    assert (space.columns_for("x", names), space.columns_for("y-1", names)) == ((0, 2), (0, 1, 2))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"known": {"z": "x"}}, ["--known", "'z'", "x, y-1"]),
        ({"known": {"x": "1", "dx": "2"}}, ["--known", "'x'", "twice"]),
        ({"known": {"x": "3*w"}}, ["--known for 'x'", "'w'", "known: x, y_1, u"]),
        ({"known": {"x": "3*"}}, ["--known for 'x'"]),
        ({"guesses": {"x": ("x +",)}}, ["--guess for 'x'"]),
        ({"guesses": {"x": ("foo(x)",)}}, ["--guess for 'x'", "'foo'"]),
        ({"guesses": {"x": ("exp(x)",)}}, ["guess 'exp(x)' for 'x'", "'exp'", "+,-,*,/,sin,cos"]),
        ({"guesses": {"x": ("x*u",)}, "variables_of": {"x": ("x", "y-1")}}, ["uses u", "x, y_1 only"]),
        ({"guesses": {"x": ("x/u",)}, "operators_of": {"x": ("+", "*")}}, ["'/'", "+,*"]),
        ({"guesses": {"x": ("+".join(f"{n}*x" for n in range(3, 12)),)}}, ["10 different variables", "room for 8"]),
        ({"guesses": {"x": ("x*x+u",)}, "space": {"max_size": 3}}, ["size 4", "--max-size is 3"]),
        ({"guesses": {"x": ("x",) * 5}, "evolution": EvolutionConfig(population=16)}, ["5 guesses", "at most 4"]),
        ({"guesses": {"x": ("x",)}, "known": {"dx": "1"}}, ["--guess", "'x'", "known"]),
        ({"operators_of": {"x": ("+",)}, "known": {"x": "1"}}, ["--operators", "'x'", "known"]),
        ({"variables_of": {"x": ("x",)}, "known": {"x": "1"}}, ["--allow", "'x'", "known"]),
        ({"variables_of": {"x": ("w",)}}, ["--allow", "'w'", "x, y-1, u"]),
        ({"variables_of": {"x": ()}}, ["--allow", "no variable"]),
        ({"required_of": {"x": ("w",)}}, ["--require", "'w'", "x, y-1, u"]),
        ({"required_of": {"z": ("x",)}}, ["--require", "'z'", "searched for x, y-1"]),
        ({"required_of": {"x": ("u",)}, "variables_of": {"x": ("x",)}}, ["--require", "u", "--allow", "x only"]),
        ({"required_of": {"x": ("u",)}, "known": {"x": "1"}}, ["--require", "'x'", "known"]),
        ({"bounds": {"*": ("c >> 0",)}}, ["--bound", "c >> 0", "0 < c < 10"]),
        ({"bounds": {"*": ("c > 1",), "x": ("c < 0",)}}, ["--bound", "'c > 1' and 'c < 0' of 'x' contradict"]),
        ({"bounds": {"x": ("x*u > 1", "c < 0")}}, ["'x*u > 1' and 'c < 0' of 'x' contradict each other"]),
        ({"bounds": {"*": ("c > 0",)}, "known": {"x": "1", "y-1": "x"}}, ["--bound 'c > 0'", "all are known"]),
        ({"bounds": {"z": ("c > 0",)}}, ["--bound", "'z'", "searched for x, y-1"]),
        ({"bounds": {"x": ("c > 0",)}, "known": {"x": "1"}}, ["--bound", "'x'", "known"]),
        ({"equations": {"z": "?"}}, ["--equation", "'z'", "searched for x, y-1"]),
        ({"equations": {"x": "c*x", "dx": "?"}}, ["--equation", "'x'", "twice"]),
        ({"equations": {"x": "c*x +"}}, ["--equation for 'x'", "the text ends"]),
        ({"equations": {"x": "sin"}}, ["--equation for 'x'", "'sin'", "known: x, y_1, u"]),
        ({"equations": {"x": "ln*x"}}, ["--equation", "ln", "function"]),
        ({"equations": {"x": "y1*x"}}, ["y1", "did you mean 'y_1'?", "--parameter y1"]),
        ({"equations": {"x": "c*x"}, "parameters": {"k": {}}}, ["--parameter k", "there are: c"]),
        ({"equations": {"x": "c*x"}, "parameters": {"u": {}}}, ["--parameter u", "column"]),
        (
            {"equations": {"x": "c*x"}, "parameters": {"c": {"start": 2.0, "upper": 1.0}}},
            ["parameter c", "start value 2"],
        ),
        ({"parameters": {"c": {}}}, ["parameter c", "equation"]),
        ({"equations": {"x": "c*x"}, "known": {"dx": "1"}}, ["--known and --equation", "'x'"]),
        ({"equations": {"x": "c*x"}, "guesses": {"x": ("1",)}}, ["--guess", "'x'", "no unknown part"]),
        ({"equations": {"x": "c*x"}, "bounds": {"x": ("c > 0",)}}, ["--bound", "'x'", "no unknown part"]),
        ({"equations": {"x": "c*x"}, "variables_of": {"x": ("x",)}}, ["--allow", "'x'", "no unknown part"]),
        ({"equations": {"x": "c*x"}, "required_of": {"x": ("x",)}}, ["--require", "'x'", "no unknown part"]),
        ({"equations": {"x": "c*x"}, "operators_of": {"x": ("+",)}}, ["--operators", "'x'", "no unknown part"]),
        ({"equations": {"x": "?1", "y-1": "-?1"}, "guesses": {"y-1": ("1",)}}, ["--guess", "?1 is searched for 'x'"]),
        ({"equations": {"x": "?1 + ?2"}}, ["more unknown parts than equations"]),
        ({"equations": {"x": "?1(x)", "y-1": "?1(u)"}}, ["?1 depends on x in one place and on u in another"]),
        ({"equations": {"x": "?(w)"}}, ["x, y_1, u, not on w"]),
        ({"equations": {"x": "?(x)"}, "variables_of": {"x": ("u",)}}, ["--allow", "use u", "?(x)"]),
        ({"equations": {"x": "?(x)"}, "required_of": {"x": ("u",)}}, ["--require wants u", "x only"]),
        ({"equations": {"x": "?(x)"}, "guesses": {"x": ("u",)}}, ["uses u", "x only"]),
        ({"equations": {"x": "c*sin(?)"}}, ["write ? once, for the whole of it"]),
        ({"equations": {"x": "cos(x + ?)"}}, ["write ? once, for the whole of it"]),
        ({"equations": {"x": "abs(?)"}}, ["write ? once, for the whole of it"]),
        ({"equations": {"x": "(x + ?)**2"}}, ["write ? once, for the whole of it"]),
        ({"equations": {"x": "?*exp(?)"}}, ["write ? once, for the whole of it"]),
        ({"equations": {"x": "x + ʔ"}}, ["letter ʔ"]),
        ({"equations": {"x": "x"}, "data": DataConfig(observe={"z": "c*+"})}, ["--observe for 'z'", "the text ends"]),
        ({"equations": {"x": "x"}, "data": DataConfig(observe={"z": "ln*x"})}, ["--equation or --observe uses ln"]),
        ({"equations": {"dx/dt": "?"}, "data": DataConfig(order=2)}, ["'dx/dt'", "first derivative"]),
    ],
)
def test_what_cannot_be_used_is_one_sentence(options, words):
    with pytest.raises(UsageError) as caught:
        resolved(**options)
    assert "\n" not in str(caught.value)
    assert [word for word in words if word not in str(caught.value)] == []


def test_an_equation_too_long_to_print_is_refused():
    text = "x*y_1"
    for _ in range(12):
        text = f"({text} + u)*({text})"
    with pytest.raises(UsageError, match="--known for 'x'"):
        resolved(known={"x": text})


def test_bounds_on_all_equations_are_bounds_on_each_that_is_sought():
    config = resolved(
        bounds={"*": ("|c| < 9",), "dx/dt": ("x*u < 0",)}, known={"y-1": "x"}, required_of={"dx": ("y-1",)}
    )
    assert config.prior.bounds == {"x": ("|c| < 9", "x*u < 0")}
    assert config.space.required_of == {"x": ("y_1",)}
    assert resolve_prior(config, VARIABLES, SYMBOLS) == config


def test_a_known_equation_is_prepared_beside_the_only_one_sought():
    config = config_of(known={"dy/dt": "-x"}, data=DataConfig(only=("x",)))
    dataset = prepare(table_of(oscillator()), config).dataset
    assert dataset.variables == ("x", "y")
    programs = known_programs(dataset, resolve(config, dataset))
    assert [(name, to_infix(program, dataset.names)) for name, program in programs.items()] == [("y", "-x")]


def test_an_explicit_regression_has_no_derivatives():
    config = config_of(known={"y": "2*x"}, data=DataConfig(target="y"))
    assert prepare(table_of(oscillator()), config).dataset.variables == ("y",)
    with pytest.raises(UsageError, match="not a derivative"):
        prepare(table_of(oscillator()), config_of(known={"dy": "2*x"}, data=DataConfig(target="y")))


OF_COLUMNS = {"x": "x", "v-x": "v_x", "dx": "dx", "u": "u"}


def sides(order=1, variables=("x", "v-x")):
    return LeftSides(variables, OF_COLUMNS, order)


@pytest.mark.parametrize("text", ["x", "dx", "dx/dt", "dx/dtime", "x'", " x ", "x [m]"])
def test_first_derivatives_are_written_in_many_ways(text):
    assert sides().variable("--known", text) == "x"


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
        (None, "dx", ["'dx'", "x", "not a derivative"]),
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


def test_given_equations_are_keyed_by_variable_and_their_unknown_parts_have_their_variables():
    config = resolved(
        equations={"dx/dt": "-c*x + ?(y_1, u)", "dy_1": "?1*exp(-x)"},
        parameters={"c": {"lower": 0.1, "upper": 10.0}},
        guesses={"dx": ("2*u",)},
        bounds={"*": ("|c| < 9",)},
        operators_of={"y-1": ("+",)},
    )
    assert config.prior.equations == {"x": "-c*x + ?(y_1, u)", "y-1": "?1*exp(-x)"}
    assert config.prior.parameters == {"c": ParameterConfig(lower=0.1, upper=10.0)}
    assert config.prior.bounds == {"x": ("|c| < 9",), "y-1": ("|c| < 9",)}
    assert config.space.variables_of == {"x": ("y_1", "u")}
    assert resolve_prior(config, VARIABLES, SYMBOLS) == config


def test_bounds_on_all_equations_leave_out_equations_without_an_unknown_part():
    config = resolved(equations={"x": "c*x"}, bounds={"*": ("c > 0",)})
    assert config.prior.bounds == {"y-1": ("c > 0",)}


def shaped(equations=(), **shapes):
    return resolve_prior(JobConfig(prior=PriorConfig(equations=dict(equations), **shapes)), VARIABLES, SYMBOLS)


def test_shapes_are_keyed_by_variable_or_by_the_label_of_an_unknown_part():
    config = shaped(
        {"dx/dt": "a*x - ?1(u)", "y-1": "?1(u) + ?"},
        positive=("?1",), monotone={"?1": ("increasing in u",), "dy_1/dt": ("decreasing in y_1",)},
        limits={"x": ("u -> 0: 0",)},
    )  # fmt: skip
    prior = config.prior
    assert prior.shapes_of("x") == ("positive", "increasing in u", "u -> 0: 0")
    assert prior.shapes_of("y-1") == ("decreasing in y_1",)
    assert set(prior.shaped) == set(VARIABLES)
    assert resolve_prior(config, VARIABLES, SYMBOLS) == config
    assert config.prior.shapes_of("u") == ()


@pytest.mark.parametrize(
    ("equations", "shapes", "words"),
    [
        ({}, {"monotone": {"x": ("increasing in v",)}}, ["--monotone for 'x'", "names v", "x, y_1, u"]),
        ({"x": "?(u)"}, {"limits": {"x": ("x -> 0: 0",)}}, ["--limit for 'x'", "names x", "variables are u"]),
        ({"x": "-a*x"}, {"positive": ("x",)}, ["--positive", "no unknown part"]),
        ({"x": "?1", "y-1": "a*?1"}, {"positive": ("y-1",)}, ["--positive", "name 'x' instead"]),
        ({"x": "?", "y-1": "?"}, {"positive": ("?",)}, ["--positive", "'?'", "equations are searched for"]),
        ({}, {"positive": ("z",)}, ["--positive", "'z'"]),
        ({}, {"monotone": {"x": ("up",)}}, ["--monotone", "must be of the form", "'up'"]),
    ],
)
def test_shapes_of_what_is_not_searched_are_refused(equations, shapes, words):
    with pytest.raises(UsageError) as refusal:
        shaped(equations, **shapes)
    assert [word for word in words if word not in str(refusal.value)] == []


@pytest.mark.parametrize("side", ["exp(1/?) + x", "tanh(c*?)", "2**?", "x/?", "log(?)*u", "-?", "sqrt(?)"])
def test_an_unknown_part_may_be_wherever_the_side_determines_it(side):
    assert resolved(equations={"x": side}).prior.equations == {"x": side}


def test_second_derivatives_may_be_given():
    config = resolved(equations={"d2x/dt2": "-k*x + ?"}, data=DataConfig(order=2))
    assert config.prior.equations == {"x": "-k*x + ?"}


def test_given_equations_are_prepared_beside_the_only_one_sought():
    config = config_of(equations={"dy/dt": "-k*x"}, data=DataConfig(only=("x",)))
    assert prepare(table_of(oscillator()), config).dataset.variables == ("x", "y")


@pytest.mark.parametrize(
    ("side", "data", "words"),
    [
        ("cos(t)", {}, ["time t", "--inputs t"]),
        ("z + c", {"states": ("x", "y")}, ["uses z", "neither a state nor an input", "--inputs"]),
        ("c", {"observe": {"y": "t*x"}}, ["--equation or --observe uses the time t", "--inputs t"]),
    ],
)
def test_columns_that_are_no_variables_are_no_parameters(side, data, words):
    columns = oscillator()
    table = table_of(columns | {"z": columns["x"] ** 2})
    with pytest.raises(UsageError) as caught:
        prepare(table, config_of(equations={"dx": side}, data=DataConfig(**data)))
    assert [word for word in words if word not in str(caught.value)] == []


@pytest.mark.parametrize(
    ("name", "prior", "data", "words"),
    [
        ("k", {}, {}, ["parameter k", "no equation"]),
        ("k", {"equations": {"dx": "-x", "dy": "y"}}, {}, ["--parameter k occurs in no --equation"]),
        ("k", {"equations": {"dx": "-x", "dy": "?"}}, {}, ["--parameter k occurs in no --equation"]),
        ("k", {"equations": {"dx": "-k*x"}}, {}, ["with a parameter by run every state", "'y' has none"]),
        ("k", {"equations": {"dx": "-k*x", "dy": "y", "k": "1"}}, {}, ["'k by run' is constant", "equation of 'k'"]),
        ("k", {"equations": {"dx": "-k*x", "dy": "y"}, "known": {"dk": "1"}}, {}, ["'k by run' is constant"]),
        ("y", {"equations": {"dx": "-y*x"}}, {}, ["'y by run'", "a column"]),
        ("sin", {"equations": {"dx": "-x"}}, {}, ["'sin by run'", "a function"]),
        ("k", {"equations": {"dx": "-k*x", "dk": "0"}}, {"hidden": ("k",)}, ["'k by run'", "a hidden state"]),
        ("k", {"equations": {"dx": "-k*x"}, "initial": {"k": {"start": 1.0}}}, {}, ["--initial names 'k'"]),
        ("k", {"equations": {"dx": "-k*x"}}, {"order": 2}, ["by run and --order 2", "velocity"]),
        ("h", {"equations": {"dx": "-x", "dy": "y", "du": "h"}}, {"hidden": ("u",)}, ["nothing", "depends on", "'u'"]),
    ],
)
def test_wrong_parameters_by_run_are_refused(name, prior, data, words):
    parameters = {name: ParameterConfig(by="run")}
    config = JobConfig(prior=PriorConfig(parameters=parameters, **prior), data=DataConfig(**data))
    with pytest.raises(UsageError) as caught:
        prepare(table_of(oscillator()), config)
    assert [word for word in words if word not in str(caught.value)] == []


def test_an_unknown_part_may_use_a_parameter_by_run_only_if_it_names_it():
    def allowed(side):
        config = config_of(equations={"dx": side, "dy": "-k*y"}, parameters={"k": {"by": "run"}})
        preparation = prepare(table_of(oscillator()), config)
        return resolve_prior(config, preparation.dataset.variables, preparation.dataset.symbols).space.variables_of

    assert allowed("?") == {"x": ("x", "y")}
    assert allowed("?(x, k)") == {"x": ("x", "k")}


@pytest.mark.parametrize(
    ("equations", "data", "initial", "words"),
    [
        ({}, {"hidden": ("h",)}, {}, ["--hidden names 'h'", "no equation", "dh/dt=…"]),
        ({"dh": "-h"}, {"hidden": ("h",)}, {}, ["every state needs a given equation", "'x' has none"]),
        ({"dx": "-x", "dy": "y", "dh": "-h*x"}, {"hidden": ("h",)}, {}, ["nothing that is measured depends on", "'h'"]),
        ({"dx": "?"}, {"hidden": ("x",)}, {}, ["--hidden names 'x'", "is a column"]),
        ({}, {"hidden": ("10",)}, {}, ["--hidden names '10'", "from 1 to 9"]),
        ({}, {"hidden": ("h", "h")}, {}, ["--hidden names 'h' twice"]),
        ({}, {"observe": {"z": "x"}}, {}, ["--observe names 'z'", "x, y"]),
        ({"dx": "-x"}, {}, {"z": {"start": 1.0}}, ["--initial names 'z'", "x, y"]),
        ({"dx": "-x"}, {}, {"x": {"lower": 1.0, "upper": 0.0}}, ["initial x", "1 is not below 0"]),
        ({"dx": "-x"}, {}, {"x": {"start": 3.0, "upper": 2.0}}, ["initial x", "3 is outside its bounds"]),
        ({}, {}, {"x": {"start": 1.0}}, ["--initial belongs to given equations", "--equation"]),
    ],
)
def test_wrong_hidden_states_observed_columns_and_initial_values_are_refused(equations, data, initial, words):
    values = {name: ParameterConfig(**settings) for name, settings in initial.items()}
    config = JobConfig(prior=PriorConfig(equations=equations, initial=values), data=DataConfig(**data))
    with pytest.raises(UsageError) as caught:
        prepare(table_of(oscillator()), config)
    assert [word for word in words if word not in str(caught.value)] == []
