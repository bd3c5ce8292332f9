"""Builds a `JobConfig` from the preset, the job file and the options; later sources override earlier ones.

Pure except for reading the job file. Every error is one sentence that names the option or the key of the file.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from atoll.client.job_options import OPTIONS
from atoll_coordinator.data.roles.names_and_options import check_given_equations, check_options
from atoll_core.config import PRESETS, JobConfig
from atoll_core.errors import Field, UsageError
from atoll_core.expression.operators import BY_NAME
from atoll_core.quoting import did_you_mean


def configure(values: Mapping[str, object], job_file: object = None) -> JobConfig:
    """Return the configuration for option values by name; raises UsageError.

    None and False mean that an option is not given. `job_file` is a path or None.
    """
    settings = _read_job_file(job_file)
    given: dict[str, object] = {}
    for name, value in values.items():
        if value is not None and value is not False:
            given |= OPTIONS[name].decide(value)
    preset = given.get("preset", settings.get("preset", "default"))
    base = next((config.model_dump() for name, config in PRESETS.items() if name == preset), {})
    nested: dict[str, Any] = {}
    for dotted, value in given.items():
        group, _, key = dotted.rpartition(".")
        place = nested.setdefault(group, {}) if group else nested
        place[key] = value
    merged = _overlay(_overlay(base, settings), nested)
    try:
        config = JobConfig.model_validate(merged | {"preset": preset})
    except ValidationError as error:
        raise _refusal(error, given, job_file) from error
    for operators in (config.space.operators, *config.space.operators_of.values()):
        if operators is not None:
            _check_operators(operators)
    check_options(config.data)
    check_given_equations(config)
    return config


def _overlay(base: Mapping[str, object], top: Mapping[str, object]) -> dict[str, object]:
    """Return `base` with the groups updated by `top`: keys that are missing in `top` keep their values."""
    merged = dict(base)
    for key, value in top.items():
        below = merged.get(key)
        merged[key] = {**below, **value} if isinstance(below, dict) and isinstance(value, dict) else value
    return merged


def _read_job_file(file: object) -> dict[str, object]:
    if file is None:
        return {}
    if not isinstance(file, (str, PathLike)):
        raise UsageError("%s must be the path of a job file, but %r was given", Field("config"), file)
    try:
        return tomllib.loads(Path(file).read_text("utf-8"))
    except OSError as error:
        raise UsageError(f"the job file {file} cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"the job file {file} is not valid TOML: {error}") from error


def _refusal(error: ValidationError, given: Mapping[str, object], file: object) -> UsageError:
    """Return pydantic's first error as a sentence with the option, the allowed values and the given value."""
    complaint = error.errors()[0]
    path = [str(part) for part in complaint["loc"] if isinstance(part, str) and part != "[key]"]
    keys = {".".join(path[:2]), path[0]} & set(given)
    option = next((option for option in OPTIONS.values() if keys & set(option.settings.split())), None)
    place = Field(option.name) if option is not None else f"{'.'.join(path)} in {file}"
    value = complaint.get("input")
    if complaint["type"] == "extra_forbidden":
        known = _settings_in(path[:-1])
        hint = did_you_mean(path[-1], known)
        return UsageError("%s is not a known setting; known here: %s%s", place, ", ".join(known), hint)
    what = complaint["msg"].removeprefix("Input should be ").replace("a valid tuple", "a list")
    hint = did_you_mean(str(value), re.findall("'([^']*)'", what)) if complaint["type"] == "literal_error" else ""
    return UsageError("%s must be %s, but %r was given%s", place, what, value, hint)


def _settings_in(path: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the settings in a group of the configuration; a group may have its name from the user."""
    kind: Any = JobConfig
    for name in path:
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            kind = kind.model_fields[name].annotation
        else:  # a mapping, such as the parameters by name
            kind = next(iter(get_args(kind)[1:]), None)
    return tuple(kind.model_fields) if isinstance(kind, type) and issubclass(kind, BaseModel) else ()


def _check_operators(operators: Sequence[str]) -> None:
    if not operators:
        raise UsageError(f"the list of operators is empty; choose from {','.join(BY_NAME)}")
    for name in operators:
        if name not in BY_NAME:
            known = f"choose from {','.join(BY_NAME)}{did_you_mean(name, BY_NAME)}"
            raise UsageError(f"the operators name {name!r}, which is unknown; {known}")
        if operators.count(name) > 1:
            raise UsageError(f"the operators name {name!r} twice; name every operator once")
