"""From options and a job file to a configuration."""

from pathlib import Path

import pytest

from atoll.cli.parser import job_id, parse
from atoll.cli.request import config_of as configure
from atoll_core.config import BASE_OPERATORS, FURTHER_OPERATORS, PRESETS, JobConfig, ParameterConfig
from atoll_core.errors import UsageError


def config_of(line: str) -> JobConfig:
    return configure(parse(["run", "data.csv", *line.split()]))


@pytest.mark.parametrize(
    ("line", "group", "key", "value"),
    [
        ("--time sec", "data", "time", "sec"),
        ("--states x,y", "data", "states", ("x", "y")),
        ("--inputs u", "data", "inputs", ("u",)),
        ("--trajectory run", "data", "trajectory", "run"),
        ("--target y", "data", "target", "y"),
        ("--derivatives dx,dy", "data", "derivatives", ("dx", "dy")),
        ("--order 2", "data", "order", 2),
        ("--only x", "data", "only", ("x",)),
        ("--missing drop", "data", "missing", "drop"),
        ("--robust", "data", "robust", True),
        ("--holdout 2", "data", "holdout", 2),
        ("--holdout run=4", "data", "holdout", "run=4"),
        ("--operators +,*,sin", "space", "operators", ("+", "*", "sin")),
        ("--operators x=+,- --operators dy=*", "space", "operators_of", {"x": ("+", "-"), "dy": ("*",)}),
        ("--allow x=x,y", "space", "variables_of", {"x": ("x", "y")}),
        ("--require x=y,z", "space", "required_of", {"x": ("y", "z")}),
        (
            "--bound c>0 --bound dx/dt:x*y<0 --bound x:|c|<5",
            "prior",
            "bounds",
            {"*": ("c>0",), "dx/dt": ("x*y<0",), "x": ("|c|<5",)},
        ),
        ("--group strain", "data", "group", "strain"),
        ("--per-trajectory", "data", "per_trajectory", True),
        ("--unit x=m/s --unit t=s", "data", "units", {"x": "m/s", "t": "s"}),
        ("--guess dx=x --guess dy/dt=y --guess dx=2*x", "prior", "guesses", {"dx": ("x", "2*x"), "dy/dt": ("y",)}),
        ("--known y'=-x/10", "prior", "known", {"y'": "-x/10"}),
        ("--equation dv/dt=-c*v+?", "prior", "equations", {"dv/dt": "-c*v+?"}),
        ("--positive x,dy/dt", "prior", "positive", ("x", "dy/dt")),
        (
            "--monotone x=up --monotone dy=up --monotone x=down",
            "prior",
            "monotone",
            {"x": ("up", "down"), "dy": ("up",)},
        ),
        ("--limit ?1=S->inf:0..2", "prior", "limits", {"?1": ("S->inf:0..2",)}),
        ("--max-size 15", "space", "max_size", 15),
        ("--islands 3", "evolution", "islands", 3),
        ("--max-time 1.5h", "budget", "max_time", 5400.0),
        ("--target-error 1e-4", "budget", "target_error", 1e-4),
        ("--max-epochs 7", "budget", "max_epochs", 7),
        ("--max-epochs x=20,y=12", "budget", "max_epochs_of", {"x": 20, "y": 12}),
    ],
)
def test_every_option_sets_its_key_and_nothing_else(line: str, group: str, key: str, value: object) -> None:
    config = config_of(line)
    assert getattr(getattr(config, group), key) == value
    default = PRESETS["default"]
    untouched = default.model_copy(update={group: getattr(config, group).model_copy(update={key: None})})
    expected = default.model_copy(update={group: getattr(default, group).model_copy(update={key: None})})
    assert untouched == expected


def test_angles_are_repeatable_and_may_be_in_degrees() -> None:
    angles = config_of("--angle theta:deg --angle phi").data.angles
    assert [(angle.column, angle.degrees) for angle in angles] == [("theta", True), ("phi", False)]


def test_a_job_file_has_the_keys_of_the_configuration_and_options_override_it(tmp_path: Path) -> None:
    file = tmp_path / "job.toml"
    file.write_text('seed = 4\n[data]\nstates = ["x", "y"]\n[evolution]\nislands = 2\npopulation = 32\n')
    config = config_of(f"--config {file} --islands 5")
    assert (config.seed, config.data.states) == (4, ("x", "y"))
    assert (config.evolution.islands, config.evolution.population) == (5, 32)


def test_a_job_file_may_hold_what_is_known_beforehand(tmp_path: Path) -> None:
    file = tmp_path / "job.toml"
    file.write_text(
        '[prior]\nguesses = {x = ["2*x", "y"]}\nknown = {"dy/dt" = "-x"}\n[space.operators_of]\nx = ["+"]\n'
    )
    config = config_of(f"--config {file} --known dz=0 --operators +,-")
    assert config.prior.guesses == {"x": ("2*x", "y")}
    assert config.prior.known == {"dz": "0"}
    assert (config.space.operators_of, config.space.operators) == ({"x": ("+",)}, ("+", "-"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("c", {}),
        ("c=1", {"start": 1.0}),
        ("c=-1e-3", {"start": -1e-3}),
        ("c=0.1..10", {"lower": 0.1, "upper": 10.0}),
        ("c = -2 .. -.5", {"lower": -2.0, "upper": -0.5}),
        ("c=1 in 0.1..10", {"start": 1.0, "lower": 0.1, "upper": 10.0}),
        ("c=0..", {"lower": 0.0}),
        ("c=..10", {"upper": 10.0}),
        ("c=1 in ..10", {"start": 1.0, "upper": 10.0}),
        ("c=0..inf", {"lower": 0.0}),
        ("c by run", {"by": "run"}),
        ("c=by run", {"by": "run"}),
        ("c=2 by run", {"start": 2.0, "by": "run"}),
        ("c = 1 in 0.1..10  by run", {"start": 1.0, "lower": 0.1, "upper": 10.0, "by": "run"}),
    ],
)
def test_a_parameter_has_a_start_value_bounds_or_both(text: str, expected: dict[str, float]) -> None:
    config = configure(parse(["run", "data.csv", "--equation", "dx = c*x + ?", "--parameter", text]))
    assert config.prior.parameters == {"c": ParameterConfig(**expected)}


def test_a_job_file_may_have_given_equations(tmp_path: Path) -> None:
    file = tmp_path / "job.toml"
    file.write_text(
        '[prior]\nequations = {"dv/dt" = "-c*v + ?"}\n[prior.parameters]\nc = {lower = 0.1, upper = 10.0}\n'
    )
    prior = config_of(f"--config {file}").prior
    assert prior.equations == {"dv/dt": "-c*v + ?"}
    assert prior.parameters == {"c": ParameterConfig(lower=0.1, upper=10.0)}


@pytest.mark.parametrize(
    ("line", "further"),
    [
        ("", FURTHER_OPERATORS),
        ("--operators +,-,*,/,sin,cos", ()),
        ("--operators x=+,-,*,/,sin,cos", ()),
        ("--operators y=+,-", FURTHER_OPERATORS),
        ("--preset paper", ()),
    ],
)
def test_further_operators_may_be_tried_where_none_are_named(line: str, further: tuple[str, ...]) -> None:
    space = config_of(line).space
    assert (space.operators_for("x"), space.further_operators_for("x")) == (BASE_OPERATORS, further)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--islands 0", ["--islands", "1", "0 was given"]),
        ("--equation dx=-k*x --per-trajectory", ["--equation and --per-trajectory exclude each other", "'c by run'"]),
        ("--islands many", ["--islands", "whole number", "'many'"]),
        ("--seed -1", ["--seed", "greater than or equal to 0", "-1"]),
        ("--max-epochs 0", ["--max-epochs"]),
        (f"--max-epochs {2**63}", ["--max-epochs", f"less than {2**63}"]),  # more than a message can carry
        (f"--max-epochs x={2**70}", ["--max-epochs", f"less than {2**63}"]),
        (f"--holdout {2**63}", ["--holdout", f"less than {2**63}"]),
        ("--max-epochs x=0", ["--max-epochs"]),
        ("--max-epochs x=", ["--max-epochs", "whole number"]),
        ("--max-time 5x", ["--max-time", "60s", "'5x'"]),
        ("--max-time 0", ["--max-time", "above zero"]),
        ("--target-error 0", ["--target-error", "greater than 0"]),
        ("--target-error small", ["--target-error", "number"]),
        ("--max-size 500", ["--max-size", "120"]),
        ("--operators +,foo", ["'foo'", "unknown", "tanh"]),
        ("--operators +,+", ["'+'", "twice", "every operator"]),
        ("--operators ,", ["--operators", "operator names"]),
        ("--operators x=+,foo", ["'foo'", "unknown", "tanh"]),
        ("--operators + --operators *", ["--operators", "two lists", "x=+,-,*"]),
        ("--operators x=+ --operators x=*", ["--operators", "'x'", "twice"]),
        ("--operators x=", ["--operators", "x=+,-,*", "'x='"]),
        ("--guess x", ["--guess", "dx=3*x-2*x*y", "'x'"]),
        ("--guess =x", ["--guess", "dx=3*x-2*x*y", "'=x'"]),
        ("--known dy=", ["--known", "dy=-x/10", "'dy='"]),
        ("--known dy=1 --known dy=2", ["--known", "'dy'", "twice"]),
        ("--equation dy=", ["--equation", "dv/dt=-g/l*sin(theta) - c*v + ?", "'dy='"]),
        ("--equation dy=1 --equation dy=2", ["--equation", "'dy'", "twice"]),
        ("--equation dy=?1+c --parameter c=1 --parameter c=2", ["--parameter", "'c'", "twice"]),
        ("--equation dy=c --parameter c=0...5", ["--parameter", "'0...5'"]),
        ("--equation dy=c --parameter c=..", ["--parameter", "'..'"]),
        ("--equation dy=c --parameter c=", ["--parameter", "c=0.1..10", "'c='"]),
        ("--equation dy=c --parameter c+1", ["--parameter", "c=0.1..10", "'c+1'"]),
        ("--equation dy=c --parameter c=nan", ["--parameter", "finite", "nan"]),
        ("--equation dy=c --parameter c=3..1", ["--parameter c", "3 is not below 1"]),
        ("--equation dy=c --parameter c=3..3", ["--parameter c", "3 is not below 3"]),
        ("--parameter c", ["--parameter c", "--equation"]),
        ("--equation dy=c --stochastic", ["--equation and --stochastic exclude each other"]),
        ("--equation dy=c --target y", ["--equation and --target exclude each other"]),
        ("--equation dy=c --derivatives d", ["--equation and --derivatives exclude each other"]),
        ("--equation dy=c --preset paper", ["--equation and --preset paper exclude each other"]),
        ("--equation dy=c --group g", ["--equation and --group exclude each other"]),
        ("--allow x", ["--allow", "x=x,y", "'x'"]),
        ("--allow x=y,y", ["--allow", "'y'", "twice", "every variable"]),
        ("--require x", ["--require", "x=y", "'x'"]),
        ("--bound x:", ["--bound", "c > 0", "'x:'"]),
        ("--bound :c>0", ["--bound", "c > 0", "':c>0'"]),
        ("--unit x=m --unit x=s", ["--unit", "the unit of 'x' twice"]),
        ("--group x --states x", ["'x'", "--group", "--states"]),
        ("--max-epochs x=3,x=4", ["--max-epochs", "two numbers", "x"]),
        ("--max-epochs 3,4", ["--max-epochs", "two numbers", "all equations"]),
        ("--angle x --angle x:deg", ["--angle", "'x'", "twice"]),
        ("--preset fast", ["--preset", "'default' or 'paper'", "'fast'"]),
        ("--order 3", ["--order", "1 or 2"]),
        ("--missing ignore", ["--missing", "'refuse' or 'drop'"]),
        ("--holdout last", ["--holdout must be a number of trajectories or COLUMN=VALUE, but 'last' was given"]),
        ("--holdout 0", ["--holdout must be greater than or equal to 1, but 0 was given"]),
        ("--holdout =3", ["--holdout", "'=3' was given"]),
        ("--holdout 1 --target y", ["--holdout and --target exclude each other"]),
        ("--states x,x", ["--states", "twice"]),
        ("--states x,,y", ["--states", "separated by commas"]),
        ("--target y --derivatives dx", ["--target", "--derivatives", "exclude"]),
        ("--target y --order 2", ["--order 2", "--target", "exclude"]),
        ("--derivatives dx --order 2", ["--order 2", "--derivatives", "exclude"]),
        ("--states x,y --derivatives dx", ["2 states and 1 derivatives"]),
        ("--states x,y --inputs y", ["'y'", "--states", "--inputs", "name it once"]),
        ("--states x,run --trajectory run", ["'run'", "name it once"]),
        ("--time x --states x", ["'x'", "--time", "--states"]),
        ("--config missing.toml", ["missing.toml", "cannot be read"]),
    ],
)
def test_a_wrong_option_is_one_sentence_that_names_it(line: str, words: list[str]) -> None:
    with pytest.raises(UsageError) as caught:
        config_of(line)
    sentence = caught.value.on_command_line
    assert "\n" not in sentence
    assert [word for word in words if word not in sentence] == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[evolution]\npopulation = 7\n", ["evolution.population in", "multiple of 2", "7"]),
        ("[evolution]\npopulaton = 8\n", ["evolution.populaton in", "not a known setting", "population"]),
        ("speed = 1\n", ["speed in", "not a known setting", "seed"]),
        ('[data]\nstates = "x,y"\n', ["data.states in", "a list"]),
        ("[evolution\n", ["not valid TOML"]),
        ("evolution = 3\n", ["evolution in"]),
        ("[prior.parameters]\nc = {low = 1}\n", ["prior.parameters.c.low in", "lower, upper, start", "'lower'"]),
        ('[prior]\nguesses = {x = "2*x"}\n', ["prior.guesses.x in", "a list"]),
        ('[prior]\nguess = {x = ["2*x"]}\n', ["prior.guess in", "not a known setting", "guesses"]),
        ("[space]\noperators_of = {x = []}\n", ["the list of operators is empty"]),
        ('preset = "fast"\n', ["preset in", "'default' or 'paper'"]),
    ],
)
def test_a_wrong_job_file_is_one_sentence_that_names_the_key(text: str, words: list[str], tmp_path: Path) -> None:
    file = tmp_path / "job.toml"
    file.write_text(text)
    with pytest.raises(UsageError) as caught:
        config_of(f"--config {file}")
    assert [word for word in words if word not in str(caught.value)] == []


def test_time_may_be_the_time_column_and_an_input_at_once() -> None:
    assert config_of("--time t --inputs t").data.inputs == ("t",)


def test_a_job_id_is_checked_or_made() -> None:
    assert job_id("lotka-1") == "lotka-1"
    assert len({job_id(None) for _ in range(100)}) == 100
    with pytest.raises(UsageError, match="--id must be"):
        job_id("a/b")
