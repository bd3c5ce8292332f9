"""Between the last cut and the result: what is made of the fronts, and what happens when that breaks."""

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.pools import Pools
from atoll_coordinator.model.refinement import Refined, Refinement
from atoll_coordinator.result.equations import Constant
from atoll_coordinator.service.monitoring.job_views import ended_view
from atoll_core.config import BudgetConfig, JobConfig
from atoll_core.expression.text.parsing import from_infix
from tests.simulation.harness.simulated_cluster import World

CONFIG = JobConfig(budget=BudgetConfig(max_epochs=2))


def nothing(preparation: Preparation, config: JobConfig, pools: Pools, *_: object) -> Refinement:
    return Refinement()


def made(preparation: Preparation, config: JobConfig, pools: Pools, *_: object) -> Refinement:
    assert all(pools[variable].front for variable in preparation.dataset.variables)
    program = from_infix("0.5*x", preparation.dataset.names)
    constants = (Constant(value=0.5, fitted=0.49, std_error=0.01, interval=(0.47, 0.51), identifiable=False),)
    equation = Refined(0, program, 0.25, 0.125, constants, grade="doubtful", reason="Because.")
    return Refinement({"x": equation}, warnings=("It was hard.",))


def broken(preparation: Preparation, config: JobConfig, pools: Pools, *_: object) -> Refinement:
    raise ZeroDivisionError("planted")


def result_with(refiner) -> dict:
    world = World(refiner=refiner)
    try:
        world.submit(CONFIG)
        view, result = world.finish(), world.result()
        assert view.state == "done"
        verdicts = [equation["verdict"] for equation in result["equations"]]
        assert [variable.verdict for variable in view.variables] == verdicts
        record = world.store.job("job")
        assert record is not None
        after_restart = ended_view(record, world.store.result("job"))
        assert [variable.verdict for variable in after_restart.variables] == verdicts
        return result
    finally:
        world.close()


def test_the_equation_is_the_refined_one_and_the_front_and_digest_stay() -> None:
    refined, plain = result_with(made), result_with(nothing)
    assert refined["digest"] == plain["digest"]
    first, second = refined["equations"]
    assert (first["expression"], first["error"], first["complexity"]) == ("0.5*x", 0.25, 3)
    (constant,) = first["constants"]
    assert (constant["value"], constant["fitted"], constant["std_error"]) == (0.5, 0.49, 0.01)
    assert (constant["interval"], constant["identifiable"]) == ([0.47, 0.51], False)
    assert (first["verdict"], first["reason"]) == ("doubtful", "Because.")
    assert [member["selected"] for member in first["front"]].index(True) == 0
    assert [member["expression"] for member in first["front"]] == [
        member["expression"] for member in plain["equations"][0]["front"]
    ]
    assert second == plain["equations"][1]
    assert refined["warnings"] == ["It was hard."]


def test_a_job_whose_refining_breaks_is_done_with_the_equations_as_found() -> None:
    result = result_with(broken)
    assert result["state"] == "done"
    assert result["equations"][0]["expression"] is not None
    assert any("Refining failed (ZeroDivisionError: planted, twice)" in warning for warning in result["warnings"])
