"""`Regressor`: finds y = f(X), with scikit-learn's conventions. Needs the extra ``pip install 'atoll[sklearn]'``.

Letters in shapes: N rows, K features.
"""

import warnings
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from atoll.api.discover import discover
from atoll.model.simulation import ExtrapolationWarning
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import plain_array
from atoll_core.errors import UsageError
from atoll_core.redaction import without_secrets

if TYPE_CHECKING:
    from atoll.api.model import Model

try:
    from sklearn.base import BaseEstimator, RegressorMixin
    from sklearn.utils.validation import check_is_fitted, validate_data
except ImportError:
    raise ImportError("atoll.Regressor needs scikit-learn 1.6 or newer; run: pip install 'atoll[sklearn]'") from None

TARGET: Final = "y"


class Regressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn has no types
    """Finds y = f(X) as an expression.

    After `fit`: `model_` is the `atoll.Model`, `equation_` is its right-hand side, `n_features_in_` is K, and
    `feature_names_in_` has the column names of a frame. In expressions, features are called x0, x1, …, or have the
    names of the columns of a frame; the target is called y. Options for prior knowledge: ``bound="c > 0"``,
    ``require={"y": ["x0"]}``, ``unit={"x0": "m"}``.
    """

    def __init__(  # noqa: PLR0913  scikit-learn requires every parameter by name
        self,
        *,
        operators: object = None,
        seed: int = 0,
        max_size: int | None = None,
        bound: object = None,
        require: object = None,
        unit: object = None,
        max_epochs: int | None = None,
        max_time: object = None,
        target_error: float | None = None,
        workers: int | None = None,
        connect: str | None = None,
        progress: bool | None = None,
    ) -> None:
        """Set options of `atoll.discover`; None: its default."""
        self.operators = operators
        self.seed = seed
        self.max_size = max_size
        self.bound = bound
        self.require = require
        self.unit = unit
        self.max_epochs = max_epochs
        self.max_time = max_time
        self.target_error = target_error
        self.workers = workers
        self.connect = connect
        self.progress = progress

    def __repr__(self, N_CHAR_MAX: int = 700) -> str:
        return without_secrets(super().__repr__(N_CHAR_MAX))  # notebooks store the text

    def _repr_mimebundle_(self, **options: object) -> dict[str, str]:
        return {kind: without_secrets(text) for kind, text in super()._repr_mimebundle_(**options).items()}

    def fit(self, X: object, y: object) -> Self:
        """Find the expression of `y` (N,) from the features `X` (N, K)."""
        rows, target = validate_data(
            self, _unmasked(X), _unmasked(y), dtype=np.float64, y_numeric=True, ensure_min_samples=2
        )
        if float(np.ptp(target)) == 0.0:
            raise UsageError("y is the same number in all rows, but a target that varies was expected; check y")
        names = getattr(self, "feature_names_in_", None)
        columns = [f"x{index}" for index in range(rows.shape[1])] if names is None else [str(name) for name in names]
        label = TARGET
        while label in columns:
            label += "_"
        table = {**dict(zip(columns, rows.T, strict=True)), label: np.asarray(target, dtype=np.float64)}
        self.model_: Model = discover(table, target=label, **self.get_params())
        return self

    @property
    def equation_(self) -> str:
        """The right-hand side, with rounded constants."""
        check_is_fitted(self, "model_")
        return self.model_.equations[0].expression

    def predict(self, X: object) -> FloatArray:
        """Return f(X) (N,) for the features `X` (N, K)."""
        check_is_fitted(self, "model_")
        rows = validate_data(self, _unmasked(X), dtype=np.float64, reset=False)
        with warnings.catch_warnings():  # test folds often have rows just outside of the range of the train folds
            warnings.simplefilter("ignore", ExtrapolationWarning)
            return self.model_.predict(rows)


def _unmasked(given: object) -> object:
    """Return a masked array with NaN for its masked values, which are then refused; other objects are unchanged."""
    return plain_array(given) if isinstance(given, np.ma.MaskedArray) else given
