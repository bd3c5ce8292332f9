"""`atoll.Regressor` passes scikit-learn's own checks of an estimator; they run where scikit-learn is installed."""

import pytest

pytest.importorskip("sklearn")


@pytest.mark.slow
def test_the_regressor_passes_the_checks_of_scikit_learn() -> None:
    from sklearn.utils.estimator_checks import check_estimator

    import atoll
    from atoll.api import discover as session

    try:
        checks = check_estimator(
            atoll.Regressor(max_epochs=1, workers=1), on_fail=None, on_skip=None, expected_failed_checks={}
        )
    finally:
        session.close()
    failed = {
        check["check_name"]: check["exception"] for check in checks if check["status"] not in ("passed", "skipped")
    }
    assert failed == {}
    assert len(checks) > 40
