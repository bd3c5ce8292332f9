"""The standard deviation by which values are judged, for values of any size. Pure."""

from typing import Final

from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.trajectories.checks import check_size
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import DataError

ROUNDING: Final = 1e-12
"""Guard: a column that varies less than this share of its mean is judged by the mean, for it may well be constant."""


def bounded_standard_deviation(values: FloatArray, least: float = ROUNDING) -> float:
    """Return the standard deviation, or `least` times the mean's size where the values hardly vary."""
    mean, deviation = moments(values)
    return max(deviation, least * abs(mean), SETTINGS.checks.smallest)


def representable_standard_deviation(name: str, values: FloatArray) -> float:
    """Return the standard deviation; raises DataError when it is beyond the range of numbers."""
    deviation = bounded_standard_deviation(values)
    check_size(name, deviation)
    return deviation


def derivative_standard_deviation(state: str, values: FloatArray) -> float:
    """Return the standard deviation of a state's derivative; raises DataError when there is none to compute with."""
    if not values.any():
        raise DataError(
            f"state '{state}' stands still wherever it can be differentiated, as one that is switched between values "
            f"does, so that no equation can be sought; make it an input with --inputs {state}"
        )
    return representable_standard_deviation(f"derivative of {state}", values)
