"""Templates of the Python API: the options that they stand for, and the conventions of scikit-learn."""

import math

import pytest

import atoll
from atoll.api.discover import config_of
from atoll_core.config import ParameterConfig
from atoll_core.errors import UsageError

EQUATIONS = {"dv/dt": "-g/l*sin(theta) - c*v + ?", "dtheta/dt": "v"}


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ((0.1, 10), {"lower": 0.1, "upper": 10.0}),
        ((0, None), {"lower": 0.0}),
        ((-math.inf, 3), {"upper": 3.0}),
        (2, {"start": 2.0}),
        (None, {}),
        ("1 in 0.1..10", {"start": 1.0, "lower": 0.1, "upper": 10.0}),
        ({"start": 1, "lower": 0}, {"start": 1.0, "lower": 0.0}),
        ("0.1..10 by run", {"lower": 0.1, "upper": 10.0, "by": "run"}),
        ("by run", {"by": "run"}),
        ({"lower": 0, "by": "run"}, {"lower": 0.0, "by": "run"}),
    ],
)
def test_a_template_stands_for_the_options(value, expected):
    prior = config_of({"template": atoll.Template(EQUATIONS, parameters={"c": value})}).prior
    assert prior.equations == EQUATIONS
    assert prior.parameters == {"c": ParameterConfig(**expected)}
    assert prior == config_of({"equation": EQUATIONS, "parameter": {"c": value}}).prior


def test_a_name_with_by_run_is_not_a_shared_parameter():
    for value in ((0.1, 10), {"lower": 0.1, "upper": 10}):
        prior = config_of({"template": atoll.Template(EQUATIONS, {"c by run": value})}).prior
        assert prior.parameters == {"c": ParameterConfig(lower=0.1, upper=10.0, by="run")}


def test_texts_of_the_command_line_are_possible():
    texts = atoll.Template(["dv/dt = -g/l*sin(theta) - c*v + ?", "dtheta/dt = v"], ("c=0.1..10",))
    mapping = atoll.Template(EQUATIONS, {"c": (0.1, 10)})
    assert config_of({"template": texts}) == config_of({"template": mapping})


def test_the_constructor_stores_what_it_gets_and_params_can_be_set():
    template = atoll.Template(EQUATIONS, {"c": 1})
    copy = atoll.Template(**template.get_params())
    assert all(copy.get_params()[name] is value for name, value in template.get_params().items())
    assert copy.set_params(parameters={"c": 2}) is copy
    assert (copy.parameters, template.parameters) == ({"c": 2}, {"c": 1})
    assert eval(repr(template), {"Template": atoll.Template}).get_params() == template.get_params()
    with pytest.raises(UsageError, match="did you mean 'parameters'"):
        template.set_params(parameter={})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"template": EQUATIONS}, ["atoll.Template"]),
        ({"template": atoll.Template({}, {"c": 1})}, ["template has no equations"]),
        ({"template": atoll.Template(EQUATIONS), "equation": EQUATIONS}, ["template and equation"]),
        ({"template": atoll.Template(EQUATIONS), "parameter": "c"}, ["template and parameter"]),
        ({"template": atoll.Template(EQUATIONS, {"c": (1, 2, 3)})}, ["parameter", "two bounds for c", "(1, 2, 3)"]),
        ({"template": atoll.Template(EQUATIONS, {"c": {"low": 1}})}, ["parameter", "lower, upper, start"]),
        ({"template": atoll.Template(EQUATIONS, {"c": True})}, ["parameter", "True"]),
        ({"template": atoll.Template(EQUATIONS, {"c": "1..2 by strain"})}, ["'c' differs by strain", "by run"]),
        (
            {"template": atoll.Template(EQUATIONS), "initial": {"v": "0..1 by run"}},
            ["initial", "'v'", "leave 'by run'"],
        ),
        ({"template": atoll.Template(EQUATIONS), "target": "v"}, ["equation and target exclude each other"]),
    ],
)
def test_what_cannot_be_a_template_is_one_sentence(options, words):
    with pytest.raises(UsageError) as caught:
        config_of(options)
    assert [word for word in words if word not in str(caught.value)] == []
