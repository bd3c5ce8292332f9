"""`Regressor` follows scikit-learn's rules; it runs where scikit-learn is installed."""

import numpy as np
import pytest

pytest.importorskip("sklearn")


def test_masked_features_are_missing() -> None:
    from atoll.api import regressor

    masked = np.ma.array([[1.0], [-9999.0], [3.0]], mask=[[False], [True], [False]])
    with pytest.raises(ValueError, match="contains NaN"):
        regressor.Regressor().fit(masked, [2.0, 4.0, 6.0])
