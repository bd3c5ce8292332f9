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

    name: Text
    held_out: Flag = False
    rows: Count | None = None
    times: Curve = ()
    measured: Curves = Field(default_factory=dict)
    inputs: Curves = Field(default_factory=dict)
    input_slopes: Curves | None = Field(default_factory=dict)
    weights: Curve | None = None
    robustness_weights: Curves | None = None


class Smoothed(_Listed):
    """A trajectory of states that were smoothed, beside what was measured."""

    name: Text
    held_out: Flag = False
    times: Curve = ()
    measured: Curves = Field(default_factory=dict)
    smoothed: Curves = Field(default_factory=dict)
    residuals: Curves = Field(default_factory=dict)


class Simulated(_Listed):
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


class Smoothing(Part):
    """All smoothed trajectories: of so many `rows` these are `listed`."""

    rows: Count | None = None
    listed: Count | None = None
    trajectories: tuple[Smoothed, ...] = ()


class Simulation(Part):
    """All simulated trajectories."""

    trajectories: tuple[Simulated, ...] = ()
