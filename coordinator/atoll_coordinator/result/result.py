"""The whole result: reads and writes ``result.json``, and answers queries about it."""

import json
import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field, JsonValue, TypeAdapter

from atoll_coordinator.result.base import Count, Number, Part, Text
from atoll_coordinator.result.equations import Equation, Observation
from atoll_coordinator.result.findings import (
    Chaos,
    Correlation,
    Covariance,
    Data,
    Group,
    Kind,
    Noise,
    Process,
    Regression,
    SharedTerm,
    System,
)
from atoll_coordinator.result.listed_trajectories import Recorded, Simulated, Simulation, Smoothed, Smoothing
from atoll_coordinator.result.reading import SCHEMA, as_parts, json_of, read_file
from atoll_core.errors import UsageError

_DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"
_RARE: Final = ("group", "command", "observations", "hidden")
"""Keys that only some results have: models of one group, and results written by a command."""
_RARE_OF_EQUATIONS: Final = ("nats", "is_of_all_groups", "given", "shapes", "runs")
_RARE_OF_CANDIDATES: Final = ("unknown", "parameters")


UNTIMED: Final = -1.0
"""Placeholder for the seconds of a job whose result is built before the job ends."""


class Result(Part):
    """The result of a job; see docs/result.md."""

    version: Literal[1] = Field(default=SCHEMA, alias="schema", description="version of this format")
    job: Text | None = Field(default=None, description="id of the job")
    seed: Count | None = Field(default=None, description="seed of the search")
    preset: Text | None = Field(default=None, description="preset of the settings")
    state: Text | None = Field(default=None, description="state of the job")
    reason: Text | None = Field(default=None, description="why the job failed")
    equations: tuple[Equation, ...] = Field(description="one for each variable")
    shared_terms: tuple[SharedTerm, ...] = Field(default=(), description="terms that occur in several equations")
    observations: tuple[Observation, ...] = Field(
        default=(), description="measured columns from `--observe`, missing without one"
    )
    hidden: tuple[Text, ...] = Field(default=(), description="states from `--hidden`, missing without one")
    noise: dict[Text, Noise] = Field(default_factory=dict, description="by state")
    smoothing: Smoothing | None = Field(default=None, description="smoothed states")
    correlations: tuple[Correlation, ...] = Field(default=(), description="constants that the data hardly distinguish")
    covariance: Covariance | None = Field(default=None, description="joint covariance of all constants")
    groups: tuple[Group, ...] = Field(default=(), description="groups of trajectories whose constants may differ")
    simulation: Simulation | None = Field(
        default=None, description="simulation of the model along the measured trajectories"
    )
    chaos: Chaos | None = Field(default=None, description="properties of a chaotic model, null for other models")
    process: Process | None = Field(default=None, description="stochastic process, with `--stochastic`")
    regression: Regression | None = Field(default=None, description="measured and fitted values, with `--target`")
    symbols: dict[Text, Text] = Field(description="symbol of each column")
    system: System | None = Field(default=None, description="roles and units of the columns")
    data: Data | None = Field(default=None, description="source of the data")
    config: dict[Text, JsonValue] = Field(
        default_factory=dict, description="settings that differ from the defaults, as in a job file"
    )
    refining: Text | None = Field(default=None, description="`finished`, `max-time` or `not refined`")
    warnings: tuple[Text, ...] = Field(default=(), description="sentences about data and model")
    notes: tuple[Text, ...] = Field(default=(), description="those warnings that only inform and need no action")
    point_evaluations: Count | None = Field(default=None, description="work of all searches")
    search_seconds: Number = Field(default=None, description="duration of the searches")
    seconds: Number = Field(default=None, description="duration of the job")
    digest: Text | None = Field(default=None, description="hash of the results of the search")
    versions: dict[Text, JsonValue] = Field(default_factory=dict, description="versions of programs and packages")
    command: Text | None = Field(default=None, description="command that wrote the file")
    group: Text | None = Field(default=None, description="name of the group, in the model of one group")

    @classmethod
    def of(cls, content: "Mapping[str, object] | Result") -> "Result":
        """Return the content of a ``result.json`` as a result; raises UsageError if it is not a result."""
        return content if isinstance(content, Result) else as_parts(cls, content)

    @classmethod
    def load(cls, source: "str | Path | Mapping[str, object] | Result") -> "Result":
        """Return a result of this version or earlier from its file, the folder of its ``result.json``, or its content.

        Raises UsageError if the file cannot be read or contains no result.
        """
        if isinstance(source, Mapping | Result):
            return cls.of(source)
        file, content = read_file(source)
        try:
            return as_parts(cls, content)
        except UsageError as error:
            raise UsageError(f"{file}: {error}") from None

    def as_dict(self) -> dict[str, JsonValue]:
        """Return the content of ``result.json`` as plain values."""
        content: dict[str, Any] = self.model_dump(mode="json", by_alias=True)
        _drop_empty(content, _RARE)
        for equation in content["equations"]:
            _drop_empty(equation, _RARE_OF_EQUATIONS)
            for candidate in equation["candidates"]:
                _drop_empty(candidate, _RARE_OF_CANDIDATES)
        return content

    def to_json(self) -> str:
        """Return the content of ``result.json`` on one line."""
        return json_of(self.as_dict())

    @property
    def proper_warnings(self) -> tuple[str, ...]:
        """The warnings that are not notes."""
        return tuple(sentence for sentence in self.warnings if sentence not in self.notes)

    @property
    def by_run(self) -> tuple[str, ...]:
        """The parameters of which each trajectory has a value of its own: states with the rate 0."""
        parameters = self.settings("prior").get("parameters")
        named = parameters.items() if isinstance(parameters, dict) else ()
        return tuple(name for name, one in named if isinstance(one, dict) and one.get("by") == "run")

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """The states without a column: hidden states, and parameters by run."""
        return (*self.hidden, *self.by_run)

    @property
    def columns(self) -> System:
        """Roles and units of the columns, as far as they are known."""
        return self.system or System()

    @property
    def kind(self) -> Kind | None:
        """The kind of model, None if it is unknown."""
        return self.columns.kind

    @property
    def time(self) -> str:
        """The name of the time column, t if there is none."""
        return self.columns.time or "t"

    @property
    def units(self) -> dict[str, str]:
        """The units of columns, by name."""
        return self.columns.units

    @property
    def names(self) -> tuple[str, ...]:
        """The symbols of all variables, in the order of programs."""
        return tuple(self.symbols.values())

    @cached_property
    def columns_by_symbol(self) -> dict[str, str]:
        """The names of columns by symbol."""
        return {symbol: column for column, symbol in self.symbols.items()}

    @cached_property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """The smallest and largest measured value of each variable by symbol, if both are known and finite."""
        ends = {self.symbols.get(name, name): pair for name, pair in self.columns.ranges.items()}
        return {
            name: (low, high)
            for name, (low, high) in ends.items()
            if low is not None and high is not None and math.isfinite(low) and math.isfinite(high)
        }

    def sizes(self, states: tuple[str, ...]) -> tuple[float, ...]:
        """Return the scales of states (symbols): their largest absolute values measured.

        0 if only zeros or no values were measured. The scales define "small" for each state, regardless of its unit.
        """
        return tuple(max(map(abs, self.ranges.get(name, (0.0, 0.0)))) for name in states)

    @property
    def recorded(self) -> tuple[Recorded, ...]:
        """The measured trajectories, empty if the result has none."""
        return () if self.data is None else self.data.trajectories or ()

    @property
    def smoothed(self) -> tuple[Smoothed, ...]:
        """The smoothed trajectories."""
        return () if self.smoothing is None else self.smoothing.trajectories

    @property
    def simulated(self) -> tuple[Simulated, ...]:
        """The simulated trajectories."""
        return () if self.simulation is None else self.simulation.trajectories

    @property
    def data_settings(self) -> dict[str, JsonValue]:
        """The settings of the job for reading data that differ from the defaults."""
        return self.settings("data")

    def settings(self, part: str) -> dict[str, JsonValue]:
        """Return the settings in one section of the job that differ from the defaults."""
        settings = self.config.get(part)
        return settings if isinstance(settings, dict) else {}


def _drop_empty(content: dict[str, JsonValue], keys: tuple[str, ...]) -> None:
    for key in keys:
        if not content.get(key):
            content.pop(key, None)


def json_schema() -> dict[str, JsonValue]:
    """Return the JSON schema of ``result.json``, for other programs."""
    described = TypeAdapter(Result).json_schema(by_alias=True, mode="serialization")
    return {"$schema": _DIALECT, **described, "title": "result.json of Atoll"}


def schema_text() -> str:
    """Return the JSON schema as the text of the file in the package."""
    return json.dumps(json_schema(), indent=1, ensure_ascii=False) + "\n"


def timed(text: str, seconds: float) -> str:
    """Return the JSON of a result that was built with `UNTIMED`, with the seconds of the job in its place."""
    return text.replace(f'"seconds": {UNTIMED}', f'"seconds": {json.dumps(seconds)}', 1)
