from atoll.text.process import process_lines


def test_a_density_that_nobody_sought_is_not_said_to_be_none() -> None:
    its = {"measurement_noise": {}, "discretisation": "local linearisation", "ensemble": None, "stationary": None}
    (held,) = process_lines({"process": its, "system": {"inputs": ["u"]}})
    (alone,) = process_lines({"process": its, "system": {"inputs": []}})
    assert held == "stationary density: not sought: there are inputs"
    assert alone == "stationary density: none that simulations settle into"
