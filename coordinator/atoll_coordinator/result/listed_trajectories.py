"""Trajectories as a result lists them: as they were measured, smoothed and simulated."""

from typing import Self

from pydantic import Field, model_validator

from atoll_coordinator.result.base import Count, Curve, Curves, Flag, Numbers, Part, Text, require_lengths


class Recorded(Part):
    """A trajectory as it was measured; weights are None where all are 1, `rows` are all that there were."""

    name: Text
    held_out: Flag = False
    rows: Count | None = None
    times: Curve = ()
    measured: Curves = Field(default_factory=dict)
    inputs: Curves = Field(default_factory=dict)
    input_slopes: Curves | None = Field(default_factory=dict)
    weights: Curve | None = None
    robustness_weights: Curves | None = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        columns = (self.measured, self.inputs, self.input_slopes, self.robustness_weights)
        require_lengths(len(self.times), *columns, None if self.weights is None else {"weights": self.weights})
        return self


class Smoothed(Part):
    """A trajectory of states that were smoothed, beside what was measured."""

    name: Text
    held_out: Flag = False
    times: Curve = ()
    measured: Curves = Field(default_factory=dict)
    smoothed: Curves = Field(default_factory=dict)
    residuals: Curves = Field(default_factory=dict)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        require_lengths(len(self.times), self.measured, self.smoothed, self.residuals)
        return self


class Simulated(Part):
    """A trajectory by the model, from a fitted initial state, with its band; curves are None where it ends early."""

    name: Text
    held_out: Flag = False
    r2: Numbers = Field(default_factory=dict)
    offsets: Numbers = Field(default_factory=dict)
    start: Numbers | None = None
    times: Curve = ()
    measured: Curves = Field(default_factory=dict)
    values: Curves | None = None
    lower: Curves | None = None
    upper: Curves | None = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        require_lengths(len(self.times), self.measured, self.values, self.lower, self.upper)
        return self


class Smoothing(Part):
    """All smoothed trajectories: of so many `rows` these are `listed`."""

    rows: Count | None = None
    listed: Count | None = None
    trajectories: tuple[Smoothed, ...] = ()


class Simulation(Part):
    """All simulated trajectories."""

    trajectories: tuple[Simulated, ...] = ()
