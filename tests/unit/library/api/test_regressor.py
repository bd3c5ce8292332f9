"""`Regressor` follows scikit-learn's rules; it runs where scikit-learn is installed."""

from typing import Any

import numpy as np
import pytest

from atoll.model.model import Model
from tests.unit.library.model.results import result

pytest.importorskip("sklearn")


def test_features_are_columns_and_predictions_are_values(monkeypatch: pytest.MonkeyPatch) -> None:
    from atoll.api import regressor

    calls: list[tuple[Any, dict[str, Any]]] = []

    def discover(data: Any, **options: Any) -> Model:
        calls.append((data, options))
        contents = result({"y": "x0"}, ("x0",))
        contents["equations"][0] |= {"lhs": "y", "expression": "2.0*x0"}
        del contents["symbols"]["y"]
        return Model(contents)

    monkeypatch.setattr(regressor, "discover", discover)
    known = {"bound": "c > 0", "require": {"y": ["x0"]}, "unit": {"x0": "m"}}
    fitted = regressor.Regressor(seed=5, max_epochs=2, **known).fit([[1.0], [2.0]], [2.0, 4.0])
    ((data, options),) = calls
    assert {name: values.tolist() for name, values in data.items()} == {"x0": [1.0, 2.0], "y": [2.0, 4.0]}
    assert (options["target"], options["seed"], options["max_epochs"]) == ("y", 5, 2)
    assert known.items() <= options.items()
    assert fitted.predict(np.array([[3.0]])).tolist() == [6.0]
    assert fitted.equation_ == "2*x0"
    assert fitted.score([[1.0], [2.0]], [2.0, 4.0]) == 1.0


def test_masked_features_are_missing() -> None:
    from atoll.api import regressor

    masked = np.ma.array([[1.0], [-9999.0], [3.0]], mask=[[False], [True], [False]])
    with pytest.raises(ValueError, match="contains NaN"):
        regressor.Regressor().fit(masked, [2.0, 4.0, 6.0])
