"""From options and a job file to a `JobConfig`: preset, then the file, then the options, each overriding the former.

Pure apart from reading the job file. Every refusal is one sentence that names the option or the key of the file.
"""

import argparse
import contextlib
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from atoll.cli.options.names import names
from atoll.cli.options.prior_knowledge import prior_settings
from atoll_core.command_line import duration
from atoll_core.config import PRESETS, DataConfig, JobConfig
from atoll_core.errors import UsageError
from atoll_core.expression.operators import BY_NAME
from atoll_core.hints import did_you_mean


def job_config(options: argparse.Namespace) -> JobConfig:
    """Return the configuration that the options of ``run`` or ``submit`` describe; raises UsageError."""
    file = _read_job_file(options.config)
    given = _given(options)
    preset = given.get("preset", file.get("preset", "default"))
    base = PRESETS[preset].model_dump() if preset in ("default", "paper") else {}
    merged = _overlay(_overlay(base, file), _nested(given))
    merged["preset"] = preset
    try:
        config = JobConfig.model_validate(merged)
    except ValidationError as error:
        raise UsageError(_sentence(error, given, options.config)) from error
    _check(config)
    return config


def seconds(text: str, option: str = "--max-time") -> float:
    """Return the seconds of ``90``, ``60s``, ``10m`` or ``1.5h``; raises UsageError."""
    with contextlib.suppress(argparse.ArgumentTypeError):
        if (found := duration(text)) > 0.0:
            return found
    raise UsageError(f"{option} must be a time above zero such as 90, 60s, 10m or 1h, but {text!r} was given")


def epochs(text: str, option: str = "--max-epochs") -> dict[str, Any]:
    """Return the budget keys of ``50`` or ``x=20,y=12``, or of both together."""
    budget: dict[str, Any] = {}
    for part in names(text, option):
        name, separator, number = part.rpartition("=")
        count = _whole(number, option)
        if name in budget.get("max_epochs_of", {}) or (not separator and "max_epochs" in budget):
            raise UsageError(f"{option} gives two numbers of epochs for {name or 'all equations'}; give one")
        if separator:
            budget.setdefault("max_epochs_of", {})[name] = count
        else:
            budget["max_epochs"] = count
    return budget


def _angle(text: str) -> dict[str, Any]:
    column, separator, unit = text.rpartition(":")
    if separator and unit in ("deg", "rad"):
        return {"column": column, "degrees": unit == "deg"}
    return {"column": text}


def _whole(text: str, option: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise UsageError(f"{option} must be a whole number, but {text!r} was given") from None


def _holdout(text: str, option: str) -> int | str:
    """Return the number of trajectories, or ``COLUMN=VALUE`` as it is."""
    if "=" in text:
        return text
    try:
        return int(text)
    except ValueError:
        raise UsageError(f"{option} must be a number of trajectories or COLUMN=VALUE, but {text!r} was given") from None


def _number(text: str, option: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"{option} must be a number such as 1e-4, but {text!r} was given") from None


def _text(text: str, _: str) -> str:
    return text


_Reader = Callable[[str, str], Any]
_OPTIONS: Final[Mapping[str, tuple[str, _Reader]]] = {
    "seed": ("seed", _whole),
    "preset": ("preset", _text),
    "time": ("data.time", _text),
    "states": ("data.states", names),
    "inputs": ("data.inputs", names),
    "trajectory": ("data.trajectory", _text),
    "target": ("data.target", _text),
    "derivatives": ("data.derivatives", names),
    "order": ("data.order", _whole),
    "only": ("data.only", names),
    "offsets": ("data.offsets", names),
    "missing": ("data.missing", _text),
    "holdout": ("data.holdout", _holdout),
    "weights": ("data.weights", _text),
    "group": ("data.group", _text),
    "max_size": ("space.max_size", _whole),
    "islands": ("evolution.islands", _whole),
    "max_time": ("budget.max_time", seconds),
    "target_error": ("budget.target_error", _number),
}
"""By option: the key of the configuration that it sets, and how its text is read."""

_PRIOR: Final = ("guess", "known", "operators", "allow", "require", "bound", "unit")
_FLAGS: Final = {
    "data.angles": "--angle",
    "budget.max_epochs": "--max-epochs",
    "budget.max_epochs_of": "--max-epochs",
    "space.operators": "--operators",
    "space.operators_of": "--operators",
    "space.variables_of": "--allow",
    "space.required_of": "--require",
    "prior.bounds": "--bound",
    "data.units": "--unit",
    "data.per_trajectory": "--per-trajectory",
    "prior.guesses": "--guess",
    "prior.known": "--known",
}
"""By key: the repeatable option that sets it."""


def _given(options: argparse.Namespace) -> dict[str, Any]:
    """Return the values of the options that were given, by dotted key of the configuration."""
    values: dict[str, Any] = {}
    for option, (key, read) in _OPTIONS.items():
        text = getattr(options, option)
        if text is not None:
            values[key] = read(text, _flag(option))
    for switch in ("robust", "stochastic", "per_trajectory"):
        if getattr(options, switch):
            values[f"data.{switch}"] = True
    if options.angle is not None:
        values["data.angles"] = [_angle(text) for text in options.angle]
    values |= prior_settings({_flag(option): getattr(options, option) for option in _PRIOR})
    if options.max_epochs is not None:
        values |= {f"budget.{key}": value for key, value in epochs(options.max_epochs).items()}
    return values


def _flag(option: str) -> str:
    return "--" + option.replace("_", "-")


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    nested: dict[str, Any] = {}
    for dotted, value in values.items():
        *groups, key = dotted.split(".")
        place = nested
        for group in groups:
            place = place.setdefault(group, {})
        place[key] = value
    return nested


def _overlay(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with the groups of `top` laid over it: a key that `top` does not name keeps its value."""
    merged = dict(base)
    for key, value in top.items():
        below = merged.get(key)
        merged[key] = {**below, **value} if isinstance(below, dict) and isinstance(value, dict) else value
    return merged


def _read_job_file(name: str | None) -> dict[str, Any]:
    if name is None:
        return {}
    try:
        return tomllib.loads(Path(name).read_text("utf-8"))
    except OSError as error:
        raise UsageError(f"the job file {name} cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"the job file {name} is not valid TOML: {error}") from error


def _sentence(error: ValidationError, given: Mapping[str, Any], file: str | None) -> str:
    """Turn the first complaint of pydantic into our words: which option, what is allowed, what was found."""
    complaint = error.errors()[0]
    place = [str(part) for part in complaint["loc"] if isinstance(part, str) and part != "[key]"]
    found = complaint.get("input")
    if complaint["type"] == "extra_forbidden":
        settings = _settings(place[:-1])
        known = f"known here: {', '.join(settings)}{did_you_mean(place[-1], settings)}"
        return f"{_place(place, given, file)} is not a known setting; {known}"
    what = complaint["msg"].removeprefix("Input should be ").replace("a valid tuple", "a list")
    close = did_you_mean(str(found), re.findall("'([^']*)'", what)) if complaint["type"] == "literal_error" else ""
    return f"{_place(place, given, file)} must be {what}, but {found!r} was given{close}"


def _settings(group: Sequence[str]) -> tuple[str, ...]:
    model: Any = JobConfig
    for name in group:
        model = model.model_fields[name].annotation
    return tuple(model.model_fields) if hasattr(model, "model_fields") else ()


def _place(path: Sequence[str], given: Mapping[str, Any], file: str | None) -> str:
    dotted = ".".join(path[:2])
    if dotted in given or path[0] in given:
        return _flag_of(dotted if dotted in given else path[0])
    return f"{'.'.join(path)} in {file}"


def _flag_of(key: str) -> str:
    return _FLAGS.get(key) or next(_flag(option) for option, (name, _) in _OPTIONS.items() if name == key)


def _check(config: JobConfig) -> None:
    for operators in (config.space.operators, *config.space.operators_of.values()):
        _check_operators(operators)
    _check_modes(config.data)
    _check_holdout(config.data)
    _check_columns(config.data)
    _check_angles(config.data)


def _check_operators(operators: Sequence[str]) -> None:
    if not operators:
        raise UsageError(f"the list of operators is empty; choose from {','.join(BY_NAME)}")
    for name in operators:
        if name not in BY_NAME:
            known = f"choose from {','.join(BY_NAME)}{did_you_mean(name, BY_NAME)}"
            raise UsageError(f"the operators name {name!r}, which is unknown; {known}")
        if operators.count(name) > 1:
            raise UsageError(f"the operators name {name!r} twice; name every operator once")


def _check_modes(data: DataConfig) -> None:
    if data.target is not None and data.derivatives is not None:
        raise UsageError("--target and --derivatives contradict each other; give the one that the data hold")
    if data.order == 2 and data.target is not None:
        raise UsageError("--order 2 and --target contradict each other: an explicit regression has no derivative")
    if data.order == 2 and data.derivatives is not None:
        raise UsageError("--order 2 and --derivatives contradict each other; name the velocities as --states instead")
    if data.derivatives is not None and data.states is not None and len(data.derivatives) != len(data.states):
        counts = f"{len(data.derivatives)} columns for {len(data.states)} states"
        raise UsageError(f"--derivatives gives {counts}; give one for each state, in the same order")


def _check_holdout(data: DataConfig) -> None:
    if data.holdout is not None and data.target is not None:
        raise UsageError("--holdout and --target contradict each other: an explicit regression has no trajectories")


def _check_columns(data: DataConfig) -> None:
    """Refuse a column in two roles."""
    roles = {
        "--states": data.states or (),
        "--inputs": data.inputs,
        "--derivatives": data.derivatives or (),
        "--target": (data.target,) if data.target is not None else (),
        "--trajectory": (data.trajectory,) if data.trajectory is not None else (),
        "--weights": (data.weights,) if data.weights is not None else (),
        "--group": (data.group,) if data.group not in (None, data.trajectory) else (),
    }
    first: dict[str, str] = {}
    for role, columns in roles.items():
        for column in columns:
            if column in first:
                raise UsageError(f"{column!r} is named by both {first[column]} and {role}; a column has one role")
            first[column] = role
    if data.time is not None and first.get(data.time, "--inputs") != "--inputs":
        raise UsageError(f"{data.time!r} is named by both --time and {first[data.time]}; a column has one role")


def _check_angles(data: DataConfig) -> None:
    """Refuse an angle that is named twice, perhaps in two units."""
    columns = [angle.column for angle in data.angles]
    for column in columns:
        if columns.count(column) > 1:
            raise UsageError(f"--angle names {column!r} twice; name every angle once")
