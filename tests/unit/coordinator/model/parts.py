"""Parts of results with few words."""

from typing import Any

from atoll_coordinator.result.equations import Constant, Prediction
from atoll_coordinator.result.findings import Chaos


def constant(
    value: float, fitted: float | None = None, std_error: float | None = None,
    interval: tuple[float, float] | None = None, **more: Any,
) -> Constant:  # fmt: skip
    return Constant(value=value, fitted=fitted, std_error=std_error, interval=interval, **more)


def prediction(starts: int, followed: int, probability: float, novelty: float = 0.1, **more: Any) -> Prediction:
    known = {"unfinished": 0, "is_disputed": False, **more}
    return Prediction(starts=starts, followed=followed, probability=probability, novelty=novelty, **known)


def chaos(time: float, is_kept: bool, probability: float | None, *, is_unfinished: bool = False) -> Chaos:
    return Chaos(lyapunov_time=time, is_kept=is_kept, probability=probability, is_unfinished=is_unfinished)
