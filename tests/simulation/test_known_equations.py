"""Jobs of which some equations are known: these are not searched, and stand in the result in their order."""

import pytest

from atoll_core.config import BudgetConfig, JobConfig, PriorConfig
from tests.simulation.harness.simulated_cluster import World


def config_of(*known: str, **budget: object) -> JobConfig:
    prior = PriorConfig(known=dict.fromkeys(known, "0.5*x"))
    return JobConfig(prior=prior, budget=BudgetConfig(max_epochs=2, **budget))


@pytest.fixture
def world():
    world = World()
    yield world
    world.close()


def test_a_known_equation_is_shown_from_the_beginning_and_never_placed(world: World) -> None:
    world.submit(config_of("y"), "x,y,z")
    result = world.finish()
    assert [view.variable for view in result.variables] == ["x", "y", "z"]
    assert [view.why == "known" for view in result.variables] == [False, True, False]
    equations = world.result()["equations"]
    assert [equation["variable"] for equation in equations] == ["x", "y", "z"]
    assert (equations[1]["expression"], equations[1]["why"], equations[1]["point_evaluations"]) == ("0.5*x", "known", 0)
    assert all(equation["why"] == "max-epochs" for equation in (equations[0], equations[2]))


def test_what_is_searched_comes_out_as_without_a_known_equation(world: World) -> None:
    world.submit(config_of("y"), "x,y", "with")
    world.submit(config_of(), "x,y", "without")
    world.finish("with")
    world.finish("without")
    first, second = world.result("with"), world.result("without")
    assert {**first["equations"][0], "seconds": 0} == {**second["equations"][0], "seconds": 0}
    assert first["equations"][1] != second["equations"][1]


def test_a_job_whose_equations_are_all_known_is_done_without_a_search() -> None:
    world = World(workers=1)
    try:
        result = world.run(config_of("x", "y"))
        assert not world.computes["w0"].turns
        assert [equation["why"] for equation in result["equations"]] == ["known", "known"]
        assert result["point_evaluations"] == 0
    finally:
        world.close()


def test_epochs_for_a_known_equation_are_refused(world: World) -> None:
    world.submit(config_of("y", max_epochs_of={"y": 3}))
    view = world.finish()
    assert (view.state, view.fault) == ("failed", "data")
    assert view.reason == "--max-epochs names 'y', for which no equation is searched; equations are searched for: x"


def test_what_cannot_be_read_fails_the_job_with_a_sentence(world: World) -> None:
    world.submit(JobConfig(prior=PriorConfig(known={"y": "3*w"})))
    view = world.finish()
    assert (view.state, view.fault) == ("failed", "data")
    assert "--known for 'y': 'w'" in (view.reason or "")


def test_one_without_a_value_on_some_rows_can_be_looked_at_and_is_warned_of(world: World) -> None:
    world.submit(JobConfig(prior=PriorConfig(known={"y": "1/x"}), budget=BudgetConfig(max_epochs=1)))
    view = world.finish()
    assert (view.variables[1].error, view.variables[1].normalized_error) == (None, None)
    assert not view.variables[1].converged
    assert view.warnings == ("The known equation of 'y' has no finite value on 1 of 20 rows.",)
