"""Results: the shape other programs rely on, the digest, and the renderings for people."""

import csv
import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from atoll.text.render import parse_picks
from atoll_coordinator.data.recording import Preparation, Source
from atoll_coordinator.model.refinement import Refined, Refinement
from atoll_coordinator.model.result.building import KNOWN, Account, VariableOutcome, build_result, result_digest
from atoll_coordinator.result.equations import Equation
from atoll_coordinator.result.findings import Correlation, Place
from atoll_coordinator.result.listed_trajectories import Simulated, Simulation
from atoll_core.config import BudgetConfig, JobConfig, PriorConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.errors import UsageError
from atoll_core.expression.simplification import complexity
from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.pareto import FrontEntry
from tests.unit.coordinator.model.parts import constant
from tests.unit.coordinator.model.result.plain import pick, render_text, rendered

NAMES = ("x", "S", "v")
SYMBOLS = {"x": "x", "S": "S", "v [m/s]": "v"}
TRUTH = "x*(3.0 - x - 2.0*S)"


def entry(text: str, error: float, epoch: int = 0, generation: int = 5, island: int = 0) -> FrontEntry:
    program = from_infix(text, NAMES)
    return FrontEntry(complexity(program), error, error * error, epoch, generation, island, program.to_bytes())


def dataset(floor: float = 0.0) -> Dataset:
    values = np.linspace(-2.0, 2.0, 50)
    targets = (Target("x", "dx/dt", values, floor, 1.25, 0.0), Target("v", "dv/dt", values, floor, 1.25, 0.0))
    x = np.linspace(1.0, 2.0, 50)
    inputs = np.array([x, 0.5 * (3.0 - x - values / x), np.ones(50)])  # the truth is the target
    return Dataset(NAMES, inputs, targets, SYMBOLS, ("two rows were dropped",))


PREPARATION = Preparation(dataset())


def outcomes() -> list[VariableOutcome]:
    front = (entry("1.5", 1.0), entry("2.0*x", 0.4), entry(TRUTH, 1e-13, epoch=2, generation=85))
    first = VariableOutcome("x", front, 3, 285, {"offspring": 2000, "fitting": 130}, 0.05, "target")
    return [first, VariableOutcome("v", (), 0)]


def result(**changes: object) -> dict:
    account = Account("done", 1.9, 0.4)
    return build_result("job-1", JobConfig(seed=7), PREPARATION, outcomes(), replace(account, **changes)).as_dict()


def test_the_equation_says_what_was_found_when_and_at_what_cost():
    equation = result()["equations"][0]
    assert equation["expression"] == TRUTH
    assert equation["lhs"] == "dx/dt"
    assert equation["converged"] is True
    assert (equation["epoch"], equation["generation"], equation["why"]) == (3, 285, "target")
    assert equation["error"] == 1e-13
    assert equation["normalized_error"] == 1e-13 / 1.25
    unknown = {"std_error": None, "fitted": None, "interval": None, "identifiable": True, "simple": None}
    unknown |= {"bounds": None, "at_bound": False, "shared": None, "unit": None}
    assert equation["constants"] == [{"value": 3.0, **unknown}, {"value": 2.0, **unknown}]
    assert equation["point_evaluations"] == 2130
    assert equation["point_evaluations_by_part"] == {"fitting": 130, "offspring": 2000}


def test_convergence_is_listed_by_island_relative_to_the_target():
    steps = {1: ((7, 2.5),), 0: tuple((generation, 250.0 - generation) for generation in range(200))}
    outcome = replace(outcomes()[0], convergence=steps)
    written = build_result("job-1", JobConfig(), PREPARATION, [outcome], Account("done", 1.0, 1.0)).as_dict()
    first, second = written["equations"][0]["convergence"]
    assert second == {"island": 1, "generations": [7], "errors": [2.0]}
    assert (len(first["errors"]), first["generations"][0], first["generations"][-1]) == (40, 0, 199)


def test_measured_and_fitted_values_of_a_regression_are_listed():
    source = Source("0" * 64, ("a.csv",), 50, {}, None, (), (), ("x", "S", "v [m/s]"), "v [m/s]", 1)
    given = replace(PREPARATION, source=source)
    written = build_result("job-1", JobConfig(), given, outcomes()[:1], Account("done", 1.0, 1.0)).as_dict()[
        "regression"
    ]
    assert (written["rows"], written["listed"]) == (50, 50)
    assert written["fitted"] == pytest.approx(written["measured"], abs=1e-6)
    assert written["measured"][:2] == pytest.approx([-2.0, -1.918367])
    assert set(written["variables"]) == {"x", "S", "v [m/s]"}
    assert result()["regression"] is None


def test_the_front_marks_exactly_the_selected_member():
    front = result()["equations"][0]["front"]
    assert [member["selected"] for member in front] == [False, False, True]
    assert front[1]["r2"] == pytest.approx(1.0 - 0.16 / 1.5625)
    assert {member["holdout_error"] for member in front} == {None}


def test_members_that_are_one_function_fall_together_and_the_front_is_one_of_shortest_writings():
    front = (
        entry("1.5", 1.0),
        entry("x + S - S", 0.5),
        entry("x*S/S + S*x/x", 0.3),
        entry("x*x/x + 0.0*v", 0.4),
        entry("sin(v + 1.5707963267948966)", 0.35),
    )
    selected = VariableOutcome("x", front, 1)
    shown = build_result("j", JobConfig(), PREPARATION, [selected], Account("done", 1.0, 1.0)).as_dict()["equations"][0]
    assert [(equation["expression"], equation["complexity"], equation["error"]) for equation in shown["front"]] == [
        ("x", 1, 0.4),
        ("cos(v)", 2, 0.35),
        ("x + S", 3, 0.3),
    ]
    assert [equation["selected"] for equation in shown["front"]].count(True) == 1


def test_a_known_equation_is_shown_as_it_was_given():
    given = VariableOutcome("x", (entry("x*1.0 + S - S", 0.5),), 0, why=KNOWN)
    shown = build_result("j", JobConfig(), PREPARATION, [given], Account("done", 1.0, 1.0)).as_dict()["equations"][0]
    assert shown["expression"] == shown["front"][0]["expression"] == "1.0*x + S - S"


def test_the_front_is_measured_on_held_out_rows_as_well():
    seen = dataset()
    rows = np.array([[1.0, 2.0, 4.0], [0.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    targets = tuple(replace(target, values=np.array([2.0, 4.0, 5.0])) for target in seen.targets)
    unseen = replace(seen, inputs=rows, targets=targets)
    front = (entry("2.0*x", 0.4), entry("2.5*x/v", 0.3))
    given = Preparation(seen, held_out=unseen)
    built = build_result("j", JobConfig(), given, [VariableOutcome("x", front, 1)], Account("done", 1.0, 1.0)).as_dict()
    assert [member["holdout_error"] for member in built["equations"][0]["front"]] == [1.0, None]
    lines = render_text(built, fronts=True).splitlines()
    heads, first, second = lines[(start := next(n for n, line in enumerate(lines) if "pick" in line)) : start + 3]
    assert heads.split()[:5] == ["pick", "size", "error", "held", "out"]
    assert (first.split()[3], second.split()[4]) == ("0.8", "?")


def test_an_equation_without_a_front_is_null_and_not_converged():
    equation = result(state="running")["equations"][1]
    assert equation["expression"] is None
    assert equation["converged"] is False
    assert equation["front"] == []


def test_a_generation_without_a_hit_is_that_of_the_selected_member():
    changed = [replace(outcomes()[0], generation=None), outcomes()[1]]
    built = build_result("j", JobConfig(), PREPARATION, changed, Account("done", 1.0, 1.0)).as_dict()
    assert built["equations"][0]["generation"] == 285


def test_a_result_says_how_far_its_model_can_be_trusted():
    built = result()
    assert (built["noise"], built["correlations"], built["simulation"]) == ({}, [], None)
    contents, empty = built["equations"]
    assert (contents["verdict"], empty["verdict"]) == ("doubtful", "no model")  # its constants were not fitted again
    by_name = {check["name"]: check["outcome"] for check in contents["checks"]}
    assert by_name["constants"] == "not made"
    assert set(by_name.values()) == {"passed", "not applicable", "not made"}
    assert {"time", "degrees of freedom", "no equation"} <= set(by_name)
    assert contents["candidates"] == []
    assert result(state="running")["equations"][0]["verdict"] is None


def test_numbers_that_are_not_finite_become_null():
    strange = replace(entry("x", 0.5), mse=math.inf)
    built = build_result(
        "j", JobConfig(), PREPARATION, [VariableOutcome("x", (strange,), 1)], Account("done", math.inf, 1.0)
    ).as_dict()
    text = json.dumps(built, allow_nan=False)
    assert json.loads(text)["seconds"] is None
    assert built["equations"][0]["front"][0]["r2"] is None


def test_an_explicit_target_error_decides_what_has_converged():
    config = JobConfig(budget=BudgetConfig(target_error=0.5))
    front = (entry("2.0*x", 0.4),)
    built = build_result(
        "j", config, PREPARATION, [VariableOutcome("x", front, 1)], Account("done", 1.0, 1.0)
    ).as_dict()
    assert built["equations"][0]["converged"] is True
    stricter = JobConfig(budget=BudgetConfig(target_error=0.1))
    built = build_result(
        "j", stricter, PREPARATION, [VariableOutcome("x", front, 1)], Account("done", 1.0, 1.0)
    ).as_dict()
    assert built["equations"][0]["converged"] is False


def test_an_expression_too_long_to_print_is_left_out():
    text = "x + S*v"
    for _ in range(15):
        text = f"sin({text})/({text})" if len(text) < 40_000 else text
    huge = entry(text, 1e-3)
    built = build_result(
        "j", JobConfig(), PREPARATION, [VariableOutcome("x", (huge,), 1)], Account("done", 1.0, 1.0)
    ).as_dict()
    assert built["equations"][0]["front"] == []


@pytest.mark.parametrize(
    "change",
    [
        {"epoch": 4},
        {"generation": 284},
        {"evaluations": {"offspring": 2001, "fitting": 130}},
        {"front": (entry("1.5", 1.0), entry("2.0000000000000004*x", 0.4), outcomes()[0].front[2])},
        {"front": outcomes()[0].front[:2]},
        {"runners_up": outcomes()[0].front[:1]},
        {"front": (replace(outcomes()[0].front[0], error=math.nextafter(1.0, 2.0)), *outcomes()[0].front[1:])},
    ],
)
def test_the_digest_sees_every_bit_of_what_was_found(change):
    assert result_digest([replace(outcomes()[0], **change)]) != result_digest(outcomes()[:1])


def test_the_digest_does_not_see_times_or_reasons():
    changed = replace(outcomes()[0], seconds=9.0, why="max-time", evaluations={"fitting": 130, "offspring": 2000})
    assert result_digest([changed]) == result_digest(outcomes()[:1])


def test_text_shows_rounded_equations_and_the_front_on_request():
    plain = render_text(result())
    assert "dx/dt = x*(3 - x - 2*S)" in plain
    assert "dv/dt = ?" in plain
    assert "warning: two rows were dropped" in plain
    assert "pick" not in plain
    table = render_text(result(), fronts=True)
    assert [line.split()[0] for line in table.splitlines() if line.strip()[:1].isdigit()][:3] == ["0", "1", "2"]


def test_text_of_clean_data_says_the_verdict_and_is_short():
    first = render_text(result()).split("dv/dt")[0].splitlines()
    assert len(first) == 4
    assert first[1].strip().startswith("doubtful: The errors of its 2 constants")
    assert first[2].strip().startswith("checks: ")
    assert " passed" in first[2]
    assert "doubtful" not in render_text(result(state="running"))


def refined_result() -> dict:
    constants = (constant(3.0, 2.981, 0.018, (2.945, 3.016)), constant(2.0, 2.04, 0.05))
    shown = Refined(2, from_infix(TRUTH, NAMES), 0.1, 0.02, constants, grade="doubtful", reason="It may be another.")
    curves = {"x": (1.0, 1.0, 1.0)}
    simulated = Simulated(name="1", r2={"x": 0.99}, times=(0.0, 1.0, 2.0), measured=curves, values=curves)
    places = [Place(variable="x", constant=number) for number in (0, 1)]
    model = Refinement(
        {"x": shown},
        Simulation(trajectories=(simulated,)),
        (Correlation(first=places[0], second=places[1], value=0.99),),
    )
    account = Account("done", 1.0, 1.0)
    return build_result("job-1", JobConfig(), PREPARATION, outcomes()[:1], account, model).as_dict()


def test_text_of_a_refined_model_has_constants_verdict_and_tables():
    run = render_text(refined_result())
    assert "    constants: 3 (2.981 ± 0.018), 2 (2.040 ± 0.050)\n    doubtful: It may be another.\n" in run
    assert "simulation: R2 at least 0.9900 on 1 trajectory" in run
    tables = render_text(refined_result(), fronts=True)
    assert "2.945 to 3.016" in tables
    assert "R2 of simulations" in tables
    assert "correlation 0.990" in tables


def test_text_of_a_result_from_before_verdicts_is_shown_as_it_is():
    old = result()
    for key in ("noise", "correlations", "simulation"):
        del old[key]
    for equation in old["equations"]:
        for key in ("verdict", "reason", "candidates"):
            del equation[key]
    assert "exact" not in render_text(old, fronts=True)
    assert "x*(3 - x - 2*S)" in render_text(old)


def test_csv_has_the_equation_shown_and_one_line_for_each_member():
    rows = list(csv.DictReader(io.StringIO(rendered(result(), "csv"))))
    assert [row["pick"] for row in rows] == ["", "0", "1", "2"]
    assert rows[3]["expression"] == TRUTH
    assert rows[3]["selected"] == "True"
    assert [row["shown"] for row in rows] == ["True", "False", "False", "False"]
    assert {row["origin"] for row in rows} == {"front"}
    assert (rows[0]["expression"], rows[0]["r2"]) == (rows[3]["expression"], rows[3]["r2"])


def test_sympy_source_runs_and_gives_the_equations():
    scope: dict = {}
    exec(rendered(result(), "sympy"), scope)
    x, s = scope["symbols"]["x"], scope["symbols"]["S"]
    assert scope["equations"]["dx/dt"].subs({x: 2, s: 5}) == -18.0


def test_latex_writes_fractions_and_rounded_constants():
    text = rendered(result(), "latex")
    assert r"\frac{d x}{d t} &= " in text
    assert r"\begin{align*}" in text
    assert r"x \left(3 - x - 2 S\right)" in text


def test_latex_of_nothing_found_yet_has_no_blank_line():
    empty = {**result(), "equations": [{**equation, "expression": None} for equation in result()["equations"]]}
    assert rendered(empty, "latex").splitlines() == [r"\begin{align*}", r"\end{align*}"]


def test_a_picked_equation_that_has_not_converged_is_not_said_to_have_met_the_target():
    text = render_text(pick(result(), {"x": 1}))
    assert "not converged" in text
    assert "target error was met" not in text


def test_one_equation_is_picked_once():
    with pytest.raises(UsageError, match="'x' twice"):
        parse_picks(["x=1", "x=2"])


def test_picking_takes_another_member():
    picked = pick(result(), parse_picks(["x=1"]))
    equation = picked["equations"][0]
    assert equation["expression"] == "2.0*x"
    assert equation["converged"] is False
    assert [member["selected"] for member in equation["front"]] == [False, True, False]
    assert (equation["verdict"], equation["reason"]) == (None, None)
    assert result()["equations"][0]["expression"] == TRUTH


def test_what_refining_found_out_does_not_belong_to_a_picked_member():
    picked = pick(refined_result(), {"x": 1})
    assert (picked["simulation"], picked["correlations"], picked["covariance"]) == (None, [], None)
    assert (picked["equations"][0]["program"], picked["equations"][0]["prediction"]) == (None, None)
    text = render_text(picked, fronts=True)
    assert "doubtful" not in text
    assert "±" not in text
    joint = {"constants": [{"variable": "x", "constant": 0}], "matrix": [[0.1]], "freedom": 9.0}
    grouped = refined_result() | {"groups": [{"group": "a", "trajectories": ["1"], "covariance": joint}]}
    assert [group["covariance"] for group in pick(grouped, {"x": 1})["groups"]] == [None]


@pytest.mark.parametrize("picks", [{"x": 3}, {"v": 0}, {"q": 0}])
def test_picking_what_is_not_there_is_refused(picks):
    with pytest.raises(UsageError):
        pick(result(), picks)


@pytest.mark.parametrize("text", ["x", "x=", "x=two", "=1", "x=-1"])
def test_malformed_picks_are_refused(text):
    with pytest.raises(UsageError, match="--pick must be"):
        parse_picks([text])


def test_an_unknown_format_is_refused():
    with pytest.raises(UsageError, match="choose one of"):
        rendered(result(), "yaml")


def test_what_is_no_model_is_not_said_to_have_converged():
    from atoll.text.render import _standing

    known = {"why": "target", "converged": True, "verdict": "no model", "normalized_error": 0.1}
    equation = Equation(variable="x", lhs="dx/dt", expression="x", complexity=3, epoch=2, **known)
    assert _standing(equation) == "error 0.1 of the target's standard deviation, size 3, epoch 2"
    assert _standing(equation.model_copy(update={"verdict": "good"})).startswith("converged: error 0.1")


def test_an_equation_whose_display_has_other_numbers_is_written_out():
    def text_of(expression, *values):
        given = result()
        known = {"std_error": 0.1, "interval": None, "identifiable": True}
        constants = [{**known, "value": value, "fitted": value} for value in values]
        given["equations"][0] |= {"expression": expression, "constants": constants}
        return render_text(given)

    assert "written out: x/(4.0*S)" in text_of("x/(4.0*S)", 4.0)
    assert "written out" not in text_of("3.0*x - 0.25*x*S", 3.0, -0.25)


def test_text_names_the_functions_that_equations_have_in_common():
    contents = result()
    factors = {"x": 1.0, "v": -2.0}
    contents["shared_terms"] = [
        {"term": "S/(1.0 + x)", "has_function": True, "factors": factors},
        {"term": "x*S", "has_function": False, "factors": factors},
    ]
    lines = [line for line in render_text(contents).splitlines() if line.startswith("shared")]
    assert lines == ["shared: S/(1 + x) in dx/dt, dv/dt"]
    contents["shared_terms"][0]["multiples"] = {"x": 1.0, "v": -2.0}
    assert "flux: S/(1 + x), +1 in dx/dt, -2 in dv/dt" in render_text(contents).splitlines()


def test_demanded_shapes_are_listed_and_named_in_the_verdict_and_missing_without_a_demand() -> None:
    prior = PriorConfig(positive=("x",), limits={"x": ("S -> 0: 0",)})
    account = Account("done", 1.0, 1.0)
    first = build_result("job-1", JobConfig(prior=prior), PREPARATION, outcomes(), account).as_dict()["equations"][0]
    assert first["shapes"] == [{"shape": "positive", "kept": False}, {"shape": "S -> 0: 0", "kept": False}]
    assert first["reason"].endswith(
        "The shape of this equation was demanded, not found: positive; S -> 0: 0 (not kept: positive, S -> 0: 0)."
    )
    plainly = build_result("job-1", JobConfig(), PREPARATION, outcomes(), account).as_dict()["equations"][0]
    assert "shapes" not in plainly
    assert first["reason"].startswith(plainly["reason"])
