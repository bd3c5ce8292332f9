from atoll.text.render import process_lines
from atoll_coordinator.result.result import Result
from tests.unit.library.model.results import result


def test_a_density_that_nobody_sought_is_not_said_to_be_none() -> None:
    process = {
        "step": 0.1,
        "measurement_noise": {},
        "discretisation": "local linearisation",
        "ensemble": None,
        "stationary": None,
    }
    (held,) = process_lines(Result.of(result({"x": "-x"}, process=process, system={"inputs": ["u"]})))
    (alone,) = process_lines(Result.of(result({"x": "-x"}, process=process, system={"inputs": []})))
    assert held == "stationary density: not computed: there are inputs"
    assert alone == "stationary density: none: simulations do not become stationary"
