"""Trajectories as a result lists them: as they were measured, smoothed and simulated."""

from typing import Self

from pydantic import Field, model_validator

from atoll_coordinator.result.base import Count, Curve, Curves, Flag, Numbers, Part, Text, misfit


class _Listed(Part):
    """A part all curves of which, by name or not, have one number for each of its times."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        fields = vars(self).values()
        by_name = [values for field in fields if isinstance(field, dict) for values in field.values()]
        if len({len(curve) for curve in (*fields, *by_name) if isinstance(curve, tuple)}) > 1:
            raise misfit("this result has a curve that is not as long as its 'times'; give it as it was written")
        return self


class Recorded(_Listed):
    """A trajectory as it was measured; weights are None where all are 1, `rows` are all that there were."""

    name: Text = Field(description="name of the trajectory")
    held_out: Flag = Field(default=False, description="whether it was held out")
    rows: Count | None = Field(default=None, description="number of its rows")
    times: Curve = Field(default=(), description="at most about 2,000 in all, spread evenly")
    measured: Curves = Field(default_factory=dict, description="by state")
    inputs: Curves = Field(default_factory=dict, description="by input")
    input_slopes: Curves | None = Field(default_factory=dict, description="by input, null where an input is held")
    weights: Curve | None = Field(default=None, description="null where all are 1")
    robustness_weights: Curves | None = Field(default=None, description="null where all are 1")


class Smoothed(_Listed):
    """A trajectory of states that were smoothed, beside what was measured."""

    name: Text = Field(description="name of the trajectory")
    held_out: Flag = Field(default=False, description="whether it was held out")
    times: Curve = Field(default=(), description="times")
    measured: Curves = Field(default_factory=dict, description="by state")
    smoothed: Curves = Field(default_factory=dict, description="by state")
    residuals: Curves = Field(default_factory=dict, description="measured minus smoothed values")


class Simulated(_Listed):
    """A trajectory by the model, from a fitted initial state, with its band; curves are None where it ends early."""

    name: Text = Field(description="name of the trajectory")
    held_out: Flag = Field(default=False, description="whether it was held out")
    r2: Numbers = Field(default_factory=dict, description="by state")
    offsets: Numbers = Field(default_factory=dict, description="measured minus state, of states with an offset")
    start: Numbers | None = Field(default=None, description="fitted initial state, velocities behind the states")
    times: Curve = Field(default=(), description="at most 200")
    measured: Curves = Field(default_factory=dict, description="null where a value is not used")
    values: Curves | None = Field(default=None, description="by state")
    lower: Curves | None = Field(default=None, description="lower end of the 95 % band")
    upper: Curves | None = Field(default=None, description="upper end of the 95 % band")


class Smoothing(Part):
    """All smoothed trajectories: of so many `rows` these are `listed`."""

    rows: Count | None = Field(default=None, description="number of rows")
    listed: Count | None = Field(default=None, description="number of rows that are here")
    trajectories: tuple[Smoothed, ...] = Field(default=(), description="the trajectories")


class Simulation(Part):
    """All simulated trajectories."""

    trajectories: tuple[Simulated, ...] = Field(default=(), description="the trajectories")
