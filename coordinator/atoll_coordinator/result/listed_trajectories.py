"""Trajectories in a result: measured, smoothed and simulated."""

from typing import Self

from pydantic import Field, model_validator

from atoll_coordinator.result.base import Count, Curve, Curves, Flag, Numbers, Part, Text, inconsistent


class _Listed(Part):
    """A part whose curves have one number for each of its times."""

    @model_validator(mode="after")
    def _check_lengths(self) -> Self:
        fields = vars(self).values()
        by_name = [values for field in fields if isinstance(field, dict) for values in field.values()]
        if len({len(curve) for curve in (*fields, *by_name) if isinstance(curve, tuple)}) > 1:
            raise inconsistent(
                "this result has a curve that is not as long as its 'times'; give the unchanged result.json"
            )
        return self


class Recorded(_Listed):
    """A measured trajectory; long ones are thinned."""

    name: Text = Field(description="name of the trajectory")
    held_out: Flag = Field(default=False, description="whether it was held out")
    rows: Count | None = Field(default=None, description="number of measured rows")
    times: Curve = Field(default=(), description="listed times, evenly spread, at most about 2,000 in all trajectories")
    measured: Curves = Field(default_factory=dict, description="by state")
    inputs: Curves = Field(default_factory=dict, description="by input")
    input_slopes: Curves | None = Field(default_factory=dict, description="by input, null if the input is held")
    weights: Curve | None = Field(default=None, description="null if all are 1")
    robustness_weights: Curves | None = Field(default=None, description="null if all are 1")


class Smoothed(_Listed):
    """A trajectory of smoothed states, with measured values."""

    name: Text = Field(description="name of the trajectory")
    held_out: Flag = Field(default=False, description="whether it was held out")
    times: Curve = Field(default=(), description="times")
    measured: Curves = Field(default_factory=dict, description="by state")
    smoothed: Curves = Field(default_factory=dict, description="by state")
    residuals: Curves = Field(default_factory=dict, description="measured minus smoothed values")


class Simulated(_Listed):
    """A simulated trajectory from a fitted initial state, with its 95 % band; curves are null after an early end."""

    name: Text = Field(description="name of the trajectory")
    held_out: Flag = Field(default=False, description="whether it was held out")
    r2: Numbers = Field(default_factory=dict, description="by state")
    offsets: Numbers = Field(default_factory=dict, description="measured value minus state, for states with an offset")
    start: Numbers | None = Field(default=None, description="fitted initial state; velocities follow the states")
    times: Curve = Field(default=(), description="at most 200 times")
    measured: Curves = Field(default_factory=dict, description="by state, null if a value is not used")
    values: Curves | None = Field(default=None, description="by state")
    lower: Curves | None = Field(default=None, description="lower end of the 95 % band")
    upper: Curves | None = Field(default=None, description="upper end of the 95 % band")


class Smoothing(Part):
    """All smoothed trajectories."""

    rows: Count | None = Field(default=None, description="number of rows")
    listed: Count | None = Field(default=None, description="number of rows listed here")
    trajectories: tuple[Smoothed, ...] = Field(default=(), description="the trajectories")


class Simulation(Part):
    """All simulated trajectories."""

    trajectories: tuple[Simulated, ...] = Field(default=(), description="the trajectories")
