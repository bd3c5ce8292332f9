"""Results as they are saved: the content of ``result.json``, which people may have cut or edited."""

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, get_args

from atoll_coordinator.stochastic.discretisation import Discretisation
from atoll_core.errors import UsageError
from atoll_core.hints import similar_file
from atoll_core.quoting import path_of, shown

SCHEMA: Final = 1
RESULT: Final = "result.json"

_NUMBERS: Final = [float]
_PAIR: Final = (float, float)
_POSITIVE: Final = "a number above 0"
_DISCRETISATIONS: Final = frozenset(get_args(Discretisation))
_CURVES: Final = {str: _NUMBERS}
_VALUES: Final = {str: float}
_CONSTANT: Final = {
    "value": float, "std_error": float, "fitted": float, "interval": _PAIR, "identifiable": bool, "bounds": _PAIR,
    "simple": {"value": float, "odds": float, "standard_errors": float}, "at_bound": bool, "shared": bool, "unit": str,
    "of": str,
}  # fmt: skip
_MEMBER: Final = {
    "expression": str, "complexity": int, "error": float, "normalized_error": float, "r2": float, "nats": float,
    "holdout_error": float, "held_out_r2": float, "cross_validated": bool, "origin": str, "selected": bool,
    "constants": [_CONSTANT],
}  # fmt: skip
_GROUP: Final = {"group": str, "expression": str, "program": str, "constants": [_CONSTANT]}
_PLACE: Final = {"variable": str, "constant": int}
_COVARIANCE: Final = {"constants": [_PLACE], "matrix": [_NUMBERS], "freedom": float}
_TRAJECTORY: Final = {
    "name": str, "held_out": bool, "rows": int, "times": _NUMBERS, "measured": _CURVES, "inputs": _CURVES,
    "input_slopes": _CURVES, "weights": _NUMBERS, "robustness_weights": _CURVES, "r2": _VALUES, "start": _VALUES,
    "values": _CURVES, "lower": _CURVES, "upper": _CURVES, "smoothed": _CURVES, "residuals": _CURVES,
    "offsets": _VALUES,
}  # fmt: skip
_TRAJECTORIES: Final = {"trajectories": [_TRAJECTORY]}
_EQUATION: Final = {
    "variable": str, "lhs": str, "expression": str, "program": str, "origin": str, "why": str, "verdict": str,
    "reason": str, "complexity": int, "epoch": int, "generation": int, "error": float, "normalized_error": float,
    "r2": float, "converged": bool, "target_error": float, "point_evaluations": int, "seconds": float, "nats": float,
    "constants": [_CONSTANT], "implied": [_CONSTANT], "groups": [_GROUP], "candidates": [_MEMBER], "front": [_MEMBER],
    "simple_together": {"constants": [int], "values": _NUMBERS, "odds": float, "chi_square": float},
    "units": {"implied": [], "faults": [str]}, "bounds": [{}], "prediction": {"measure_from": _VALUES},
    "convergence": [{"island": int, "generations": _NUMBERS, "errors": _NUMBERS}],
}  # fmt: skip
_NOISE: Final = {
    "sd": float, "relative": float, "method": str, "span": int, "degree": int, "outliers": int, "residual_rms": float,
    "doubtful": [{"times": _NUMBERS, "trajectory": str}], "doubtful_rows": int, "quantisation": {},
    "errors": {"sd": float, "proportional": float, "correlated": float, "independent_rows": float, "piece": int},
    "largest_residual": {"value": float, "time": float},
}  # fmt: skip
_DENSITY: Final = {"edges": _NUMBERS, "density": _NUMBERS, "measured": _NUMBERS, "overlap": float}
_ENSEMBLE: Final = {
    "times": _NUMBERS, "mean": _CURVES, "lower": _CURVES, "median": _CURVES, "upper": _CURVES, "trajectory": str,
}  # fmt: skip
_SYSTEM: Final = {
    "kind": str, "order": int, "time": str, "states": [str], "velocities": [str], "inputs": [str], "target": str,
    "units": {str: str}, "ranges": {str: _PAIR},
}  # fmt: skip
_RESULT: Final = {
    "job": str, "seed": int, "preset": str, "state": str, "reason": str, "digest": str, "command": str, "refining": str,
    "point_evaluations": int, "search_seconds": float, "seconds": float, "warnings": [str], "equations": [_EQUATION],
    "covariance": _COVARIANCE, "groups": [{"group": str, "trajectories": [str], "covariance": _COVARIANCE}],
    "correlations": [{"first": _PLACE, "second": _PLACE, "value": float}], "symbols": {str: str}, "chaos": {},
    "shared_terms": [{"term": str, "factors": _VALUES}], "noise": {str: _NOISE}, "smoothing": _TRAJECTORIES,
    "simulation": _TRAJECTORIES, "config": {"data": {}, "budget": {}, "space": {}}, "versions": {}, "system": _SYSTEM,
    "process": {
        "step": _POSITIVE, "discretisation": _DISCRETISATIONS, "measurement_noise": {str: {}},
        "stationary": {str: _DENSITY}, "ensemble": _ENSEMBLE,
    },
    "data": {**_TRAJECTORIES, "digest": str, "files": [str], "rows": int, "read_as": str},
}  # fmt: skip
"""What a result holds: kinds by key (`str` for any); of lists that of each item, of pairs both, of sets any."""

_NEVER_NULL: Final = frozenset(
    (
        "variable", "lhs", "name", "group", "term", "constants", "front", "candidates", "groups", "implied", "matrix",
        "convergence", "generations", "doubtful", "times", "measured", "inputs", "values", "warnings", "factors",
        "states", "faults", "files", "first", "second", "step", "discretisation",
    )
)  # fmt: skip
"""Other keys may be null, as unknown and non-finite values are; items of lists may not, unless they are numbers."""


_UNWRITABLE: Final = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
"""What a terminal obeys, and what neither XML nor UTF-8 can hold."""


class Content(dict[str, Any]):
    """An object of a result: a key that it lacks is a fault of the file, said in one sentence."""

    def __missing__(self, key: object) -> Any:
        raise UsageError(f"this result lacks {str(key)!r}; give a result.json as it was written")


def check_result(found: object) -> dict[str, Any]:
    """Return the content of a result.json; raises UsageError when it is none, or of another version.

    Texts have escapes, as ``\\x01``, for characters that no page or terminal takes.
    """
    found = _writable(found)
    if (
        not isinstance(found, Mapping)
        or found.get("schema") != SCHEMA
        or not isinstance(found.get("equations"), list)
        or not isinstance(found.get("symbols"), Mapping)
        or not all(
            isinstance(each, Mapping) and {"variable", "lhs", "expression"} <= {*each} for each in found["equations"]
        )
    ):
        raise UsageError("this is no result of this version; give the content of a saved result.json")
    checked: dict[str, Any] = _checked(found, _RESULT, "the result")
    return checked


def _writable(found: Any) -> Any:
    """Return a value in which every text, names included, can be written; what holds no text is returned as it is."""
    if isinstance(found, str):
        return _UNWRITABLE.sub(lambda its: its[0].encode("unicode_escape").decode(), found)
    if isinstance(found, Mapping):
        return {_writable(name): _writable(each) for name, each in found.items()}
    if isinstance(found, list | tuple) and any(isinstance(each, str | Mapping | list | tuple) for each in found):
        return [_writable(each) for each in found]
    return found


def _checked(found: Any, kind: Any, name: str, *, may_be_null: bool = True) -> Any:
    """Return a value with every object as `Content`; raises UsageError where it is not of its kind."""
    if isinstance(found, Mapping) and isinstance(kind, dict):
        return _object(found, kind)
    is_list = isinstance(found, list | tuple)
    if is_list and kind in (_NUMBERS, _PAIR):
        if all(each is None or isinstance(each, float | int) for each in found) and (kind != _PAIR or len(found) == 2):
            return found
    elif is_list and isinstance(kind, list):
        return [_checked(each, kind[0], name, may_be_null=False) for each in found] if kind else found
    if kind is None or (found is None and may_be_null and name not in _NEVER_NULL):
        return found
    is_number = isinstance(found, int | float) and not isinstance(found, bool)
    if (is_number and 0.0 < found < math.inf) if kind == _POSITIVE else _is_one_of(found, kind):
        return found
    if is_number if kind in (int, float) else isinstance(kind, type) and isinstance(found, kind):
        return found
    raise UsageError(
        f"this result has {shown(found)} as {name!r}, where {_named(kind)} is expected; give it as written"
    )


def _is_one_of(found: Any, kind: Any) -> bool:
    return isinstance(kind, frozenset) and isinstance(found, str) and found in kind


def _object(found: Mapping[str, Any], kind: Mapping[Any, Any]) -> Content:
    """Return an object with its values checked: lists beside times are as long as these, and a covariance is square."""
    for_any = kind.get(str)
    made = Content()
    for key, value in found.items():
        made[key] = _checked(value, kind.get(key, for_any), str(key), may_be_null=for_any in (None, float))
    if kind is _TRAJECTORY:
        curves = [its for each in made.values() if isinstance(each, dict) for its in each.values()]
        if any(isinstance(its, list | tuple) and len(its) != len(made["times"]) for its in curves):
            raise UsageError("this result has a curve that is not as long as its 'times'; give it as it was written")
    if kind is _COVARIANCE and any(len(row) != len(made["constants"]) for row in [made["matrix"], *made["matrix"]]):
        raise UsageError("this result has a covariance of other constants than it names; give it as it was written")
    return made


def _named(kind: Any) -> str:
    if isinstance(kind, type):
        return {str: "text", bool: "true or false", int: "a whole number", float: "a number"}[kind]
    if isinstance(kind, str | frozenset):
        return kind if isinstance(kind, str) else " or ".join(sorted(kind))
    return "an object" if isinstance(kind, dict) else "two numbers" if kind is _PAIR else "a list"


def read_result(path: str | Path) -> dict[str, Any]:
    """Return a saved result, by its file or the folder of its ``result.json``.

    Raises UsageError when the file cannot be read or holds none.
    """
    file_or_folder = path_of(path)
    file = file_or_folder / RESULT if file_or_folder.is_dir() else file_or_folder
    try:
        found = json.loads(file.read_text("utf-8"))
    except OSError as error:
        hint = similar_file(file_or_folder)
        raise UsageError(
            f"{file} cannot be read ({error.strerror}); give the path of a saved result.json{hint}"
        ) from error
    except ValueError as error:
        raise UsageError(f"{file} holds no JSON; give the path of a saved result.json") from error
    try:
        return check_result(found)
    except UsageError as error:
        raise UsageError(f"{file}: {error}") from None


def write_text(path: str | Path, text: str) -> None:
    """Write a file; raises UsageError."""
    try:
        path_of(path).write_text(text, "utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error.strerror}); name another file") from error
