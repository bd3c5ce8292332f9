import numpy as np
import pytest

from atoll.api.model import Model
from atoll_core.errors import UsageError
from tests.unit.library.model.results import process_result, result


def test_paths_begin_as_measured_and_have_the_moments_of_the_process() -> None:
    simulation = Model(process_result()).simulate(t=[0.0, 0.5, 1.0], paths=2000, seed=3)
    assert (simulation.time, simulation.x.shape) == ("t", (2000, 3, 1))
    assert (simulation["x"][:, 0] == 2.0).all()
    assert abs(simulation.mean[2, 0] - (1.0 + np.exp(-1.0))) < 0.04
    assert abs(simulation["x"][:, 2].var() - 0.125 * (1.0 - np.exp(-2.0))) < 0.015, "steps of 0.1, not of 0.5"


@pytest.mark.slow
def test_a_seed_gives_the_same_paths() -> None:
    model = Model(process_result())
    one, same, other = (model.simulate(t=1.0, paths=2, seed=seed).x for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


@pytest.mark.slow
def test_the_stationary_density_is_that_of_the_process_wherever_paths_begin() -> None:
    stationary = Model(process_result()).stationary_density([5.0])
    assert stationary is not None
    assert abs(stationary.mean[0] - 1.0) < 0.02
    assert abs(stationary.sd[0] - np.sqrt(0.125)) < 0.01
    edges, density = stationary["x"]
    assert abs((density * np.diff(edges)).sum() - 1.0) < 1e-9
    assert Model(process_result(drift="0.1*x", diffusion="0.01*x*x")).stationary_density() is None


def test_inputs_are_held_at_their_values_along_the_paths() -> None:
    model = Model(process_result(drift="u", diffusion="1e-12", inputs=("u",)))
    simulation = model.simulate([0.0], [0.0, 0.5, 1.0], {"u": lambda t: t}, paths=1)
    assert np.allclose(simulation.x[0, :, 0], [0.0, 0.125, 0.5], atol=1e-5)
    assert model.stationary_density(inputs={"u": 1.0}) is None


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        ({"paths": 0}, "paths must be a whole number of at least 1, but 0"),
        ({"paths": 2, "seed": -1}, "seed must be a whole number of at least 0"),
        ({"paths": 10_000_000}, "on 10000000 paths are more than"),
        ({"paths": 1, "t": [0.0, 1e6]}, r"steps of 0.1 \(the sampling interval\), more than 200000"),
        ({"paths": 1, "t": [0.0, 1e300]}, "1e\\+301 steps of 0.1"),
    ],
)
def test_what_does_not_fit_is_said(arguments: dict, fault: str) -> None:
    with pytest.raises(UsageError, match=fault):
        Model(process_result()).simulate(**arguments)


@pytest.mark.parametrize(("paths", "fault"), [(1, "at least 2, but 1"), (20_000, "20000 paths are more than 19960")])
def test_a_density_takes_two_paths_and_no_more_than_memory_holds(paths: int, fault: str) -> None:
    with pytest.raises(UsageError, match=fault):
        Model(process_result()).stationary_density(paths=paths)


@pytest.mark.slow
def test_two_paths_settle_as_many_do() -> None:
    model = Model(process_result())
    assert all(model.stationary_density([1.0], paths=2, seed=seed) is not None for seed in range(4))


@pytest.mark.parametrize(
    ("process", "fault"),
    [
        ({"step": None}, "has None as 'step', where a number above 0 is expected"),
        ({"step": -1.0}, "has -1.0 as 'step', where a number above 0 is expected"),
        ({"step": 0.1, "discretisation": "foo"}, "where Euler-Maruyama or local linearisation is expected"),
        ({}, "lacks 'step'"),
        (None, "no .process."),
    ],
)
def test_what_a_result_says_of_its_process_is_checked(process: object, fault: str) -> None:
    with pytest.raises(UsageError, match=fault):
        Model(process_result() | {"process": process}).simulate(paths=2, t=1.0)


def test_a_model_without_noise_has_no_paths() -> None:
    with pytest.raises(UsageError, match="the model has no noise"):
        Model(result({"x": "-x"})).simulate([1.0], 1.0, paths=2)
    with pytest.raises(UsageError, match="there is no input 'w'; the inputs are none"):
        Model(process_result()).stationary_density(inputs={"w": 1.0})
