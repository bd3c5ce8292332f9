"""The identifiability of the constants of a model: profiles of all of them, and what is known of them together."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll.experiments.determination import Determination, Identifiability, ProfiledConstant
from atoll.experiments.measured import measured_of
from atoll.experiments.profiles import Profile, profile
from atoll.experiments.relations import directions
from atoll.experiments.systems import Constant, Fitted, constants_of, equations_of, fit_shown
from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.model.shooting.trajectory_fit import covariance
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import UsageError

MOST_CONSTANTS: Final = 60
"""More constants than this take minutes."""
_RESTARTS: Final = 2
_BETTER: Final = 0.01
"""Deviance below that of the best fit from which a profile has found a better one."""

_BY_OPEN_ENDS: Final[Mapping[tuple[bool, bool], Determination]] = {
    (False, False): "determined",
    (False, True): "open above",
    (True, False): "open below",
    (True, True): "practically non-identifiable",
}


def identify(
    result: Result, table: Table | None = None, level: float = 0.95, spread: Spread | None = None
) -> Identifiability:
    """Return what the data (None: those of the result) determine of the constants of a model, by intervals of a level.

    The profiles of constants are independent of one another; `spread` spreads them.

    Raises:
        UsageError: the level is none, the model has no constants or too many, or there are no measurements.
        AtollError: the model cannot be simulated along them.
    """
    if not 0.0 < level < 1.0:
        raise UsageError(f"a level lies between 0 and 1, but {level!r} was given")
    measured, equations = measured_of(result, table), equations_of(result)
    if not constants_of(equations, result):
        raise UsageError("the model has no constants that were fitted, so there is nothing to profile")
    fitted = fit_shown(measured, result)
    constants = constants_of(fitted.equations, result)
    count = len(constants)
    if count > MOST_CONSTANTS:
        raise UsageError(f"the model has {count} constants that were fitted; at most {MOST_CONSTANTS} can be profiled")
    from scipy import special

    quantile = float(special.stdtrit(fitted.degrees_of_freedom, 0.5 + level / 2.0))
    fitted, profiles = _profiled(_Profiler(fitted, quantile, result, table), count, spread or Spread())
    signs = np.array([constant.sign for constant in constants])
    with np.errstate(invalid="ignore"):
        errors = np.sqrt(np.diag(covariance(fitted.fit))).tolist()
    names = [constant.name for constant in constants]
    profiled = [_profiled_constant(*described, quantile) for described in zip(constants, profiles, errors, strict=True)]
    order = sorted(range(count), key=lambda place: _reading(constants[place], fitted))
    eigendirections = directions(fitted, profiles, names, signs, quantile)
    return Identifiability(
        level,
        fitted.degrees_of_freedom,
        quantile,
        tuple(profiled[place] for place in order),
        tuple(replace(direction, weights=direction.weights[order]) for direction in eigendirections),
        measured.source,
        fitted.measured.longest,
    )


def _reading(constant: Constant, fitted: Fitted) -> tuple[int, bool, int, str]:
    """Return what orders constants as they are read: by equation, in the order of the text, factors of one last."""
    number = int(constant.name[1:]) if constant.name[:1] == "c" and constant.name[1:].isdigit() else 0
    return fitted.equations.variables.index(constant.variable), not constant.is_written, number, constant.name


@dataclass(frozen=True)
class _Parts:
    """What travels of a `_Profiler`: its result as JSON, the bytes of its table, and the rest."""

    result: str
    table: bytes | None
    quantile: float
    restarts: tuple[FloatArray, ...]

    def profiler(self) -> "_Profiler":
        result = Result.of(json.loads(self.result))
        table = None if self.table is None else Table.from_bytes(self.table)
        made = _Profiler(fit_shown(measured_of(result, table), result), self.quantile, result, table)
        for values in self.restarts:
            made = made.from_values(values) or made
        return made


@dataclass(frozen=True, eq=False)
class _Profiler:
    """The fit of a result to a table that profiles are of, followed until the root of the deviance is `quantile`.

    `restarts` are the values (P,) of constants from which it was fitted again, one after the other.
    """

    fitted: Fitted
    quantile: float
    result: Result
    table: Table | None
    restarts: tuple[FloatArray, ...] = ()

    def profile(self, index: int) -> Profile:
        """Return the profile of a constant."""
        return profile(self.fitted, index, self.quantile)

    def from_values(self, values: FloatArray) -> "_Profiler | None":
        """Return the fit from other values of the constants; None where it is no better."""
        fit = self.fitted.again(self.fitted.fit.system.with_values(values), self.fitted.fit.starts)
        if fit is None or self.fitted.deviance(fit) >= 0.0:
            return None
        return replace(self, fitted=replace(self.fitted, fit=fit), restarts=(*self.restarts, values))

    def parts(self) -> _Parts:
        """Return what travels."""
        table = None if self.table is None else self.table.to_bytes()
        return _Parts(self.result.to_json(), table, self.quantile, self.restarts)

    def itself(self) -> "_Profiler":
        """Return it as it is."""
        return self


_PROFILE: Final = BatchFunction("profile", _Parts, int, Profile, _Profiler.profile, _Parts.profiler)


def _profiled(profiler: _Profiler, count: int, spread: Spread) -> tuple[Fitted, list[Profile]]:
    """Return the profiles of all constants, and the fit that they are of: a better one where a profile has met it."""
    for _ in range(_RESTARTS + 1):
        made = spread.map(_PROFILE, profiler.itself, range(count), parts=profiler.parts)
        profiles = [likelihood for likelihood in made if likelihood is not None]
        lowest = min(profiles, key=lambda likelihood: float(likelihood.deviances.min()))
        if lowest.deviances.min() > -_BETTER:
            break
        better = profiler.from_values(lowest.path[int(np.argmin(lowest.deviances))])
        if better is None:
            break
        profiler = better
    return profiler.fitted, profiles


def _profiled_constant(constant: Constant, likelihood: Profile, error: float, quantile: float) -> ProfiledConstant:
    half = quantile * error if math.isfinite(error) else math.inf
    ends, cut = (likelihood.lower, likelihood.upper), likelihood.is_cut
    values, deviances = constant.sign * likelihood.values, likelihood.deviances
    is_open = likelihood.is_open
    if constant.sign < 0.0:
        ends, cut, is_open = (-ends[1], -ends[0]), (cut[1], cut[0]), (is_open[1], is_open[0])
        values, deviances = values[::-1], deviances[::-1]
    best = constant.sign * likelihood.best
    return ProfiledConstant(
        constant.name, constant.variable, constant.is_written, best, error, ends, (best - half, best + half),
        "structurally non-identifiable" if likelihood.is_flat else _BY_OPEN_ENDS[is_open], cut, values, deviances,
    )  # fmt: skip
