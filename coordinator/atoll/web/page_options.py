"""Options of a job as a page sends them: the options of the command line by name. This module loads quickly."""

import json
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any, Final

from atoll.client.configure import configure
from atoll.client.job_options import GROUPS, OPTIONS, Repeated
from atoll_core.config import JobConfig
from atoll_core.errors import UsageError

LABELS: Final[Mapping[str, str]] = {
    "time": "Time column",
    "step": "Time between rows, if no column has times",
    "states": "State columns",
    "inputs": "Inputs: columns without an equation",
    "hold": "Inputs that keep their value until the next row",
    "trajectory": "A new trajectory begins where this column changes",
    "group": "Constants may differ between values of this column",
    "per_trajectory": "Constants may differ between runs",
    "target": "Target column of a regression without time",
    "derivatives": "Measured derivatives",
    "order": "Order of the equations",
    "angle": "Angles",
    "only": "Search these equations only",
    "offsets": "States with an unknown offset",
    "sheet": "Sheet of the workbook",
    "missing": "Missing values",
    "missing_value": "Number that stands for a missing value",
    "robust": "Robust smoothing: outliers get little weight",
    "stochastic": "Stochastic: noise is part of the dynamics",
    "holdout": "Held-out trajectories, to test the model",
    "weights": "Weights of rows",
    "unit": "Units",
    "seed": "Seed",
    "preset": "Settings of the search",
    "operators": "Operators of expressions",
    "allow": "Variables that an equation may use",
    "require": "Variables that an equation must have",
    "bound": "Bounds on constants",
    "guess": "Initial guesses of equations",
    "known": "Known equations",
    "equation": "Given equations, with parameters and unknown parts",
    "parameter": "Parameters of given equations",
    "initial": "Initial values of states",
    "hidden": "Hidden states: states of given equations without a column",
    "observe": "Columns that are computed from states",
    "positive": "Equations or unknown parts that are nowhere negative",
    "monotone": "Equations or unknown parts that increase or decrease",
    "limit": "Limits of equations or unknown parts",
    "islands": "Islands for each equation",
    "max_size": "Largest complexity",
    "max_time": "Time limit",
    "max_epochs": "Limit of epochs",
    "target_error": "Error at which an equation counts as found",
}
"""Labels of options on a page, by name."""


def options_by_heading() -> dict[str, Any]:
    """Return the options of a job with their help, by heading."""
    return {
        "groups": {
            heading: [
                {
                    "name": option.name,
                    "flag": option.flag,
                    "label": LABELS.get(option.name, option.name.replace("_", " ")),
                    "metavar": option.metavar,
                    "help": option.help,
                    "is_repeatable": option.is_repeatable,
                }
                for option in options
            ]
            for heading, options in GROUPS.items()
        }
    }


def read_options(text: str) -> tuple[dict[str, Any], JobConfig]:
    """Return the options by name from JSON, and the configuration that follows from them; raises UsageError."""
    try:
        sent = json.loads(text or "{}")
    except (ValueError, RecursionError):
        sent = None
    if not isinstance(sent, dict):
        raise UsageError('options must be a JSON object, such as {"seed": "3"}')
    for name, value in sent.items():
        if name not in OPTIONS:
            raise UsageError("%s is not an option of a job", name[:64])
        texts = value if isinstance(value, list) else [value]
        if not all(isinstance(part, (str, bool, int, float)) for part in texts):
            raise UsageError("the option %s must be a text, true, or a list of texts", name)
    options = {name: value for name, value in sent.items() if value not in (False, "", [])}
    return options, configure(
        {name: Repeated(value) if isinstance(value, list) else value for name, value in options.items()}
    )


def sizes_by_name(names: Sequence[str], sizes: Sequence[str]) -> dict[str, int | None]:
    """Return the bytes of each file in a body, in order (None: the whole body); raises UsageError."""
    plain = [PurePath(name.replace("\\", "/")).name for name in names or ["data.csv"]]
    for name in plain:
        if not name or name in (".", "..") or len(name.encode("utf-8", "replace")) > 200 or not name.isprintable():
            raise UsageError("the name of a file must be printable and have at most 200 bytes, such as data.csv")
    known = [int(size) if size.isdecimal() and len(size) < 16 else None for size in sizes]
    if len(plain) == 1 and not sizes:
        return {plain[0]: None}
    if len(known) != len(plain) or None in known or len({*plain}) < len(plain):
        raise UsageError(
            "several files were sent; give a different `filename` and the size `bytes`, a whole number, for each file"
        )
    return dict(zip(plain, known, strict=True))
