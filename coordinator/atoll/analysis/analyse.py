"""Analyse the dynamics of a model: fixed points, cycles, basins, branches, and a comparison with the data."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from atoll.analysis.analysis import Analysis
from atoll.analysis.basins import Attractor, Basins, basins
from atoll.analysis.conserved import conserved_quantities, is_volume_preserving
from atoll.analysis.continuation import Branch, Coefficients, ContinuationParameter, continuation
from atoll.analysis.cycle_continuation import CycleBranch, cycle_continuation
from atoll.analysis.dynamics import MeasuredTrajectory, compare, measured_trajectories
from atoll.analysis.fixed_points import fixed_points
from atoll.analysis.flow import Box, Flow
from atoll.analysis.limit_cycles import LimitCycle, limit_cycles
from atoll.analysis.lyapunov import LyapunovSpectrum, lyapunov_spectrum
from atoll.analysis.nullclines import nullclines
from atoll.model.arguments import by_name, interval, number
from atoll.model.core import ModelCore
from atoll.model.vector_field import VectorField
from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.quoting import did_you_mean, shown

MOST_STATES: Final = 12
"""Largest number of states. The Lorenz 96 model with 12 states takes 8 s on one core; an analysis may take 10 s."""

_MARGIN: Final = 0.5
"""The default box is wider than the measured range by this share of its width on either side. The margin decides where
the analysis searches. The analysis reports the box, and the margin does not change results inside the range."""


@np.errstate(all="ignore")  # rates may overflow in a part of the box
def analyse(
    field: VectorField,
    box: Box,
    *,
    inputs: FloatArray | None = None,
    measured: Sequence[MeasuredTrajectory] = (),
    vary: tuple[str, tuple[float, float]] | None = None,
    spread: Spread | None = None,
) -> Analysis:
    """Return the dynamics of `field` in `box`. Every part has a limited number of steps and reports the extent of its
    search.

    The `inputs` (U,) are constant, by default 0. The model is compared with the `measured` trajectories. `vary` is the
    name of a parameter, in the form for `Coefficients.find`, and its range. `spread` distributes the searches for
    cycles, and afterwards the parts that take longest, over workers. Raises UsageError for more than `MOST_STATES`
    states and for an unknown name.
    """
    if len(field.states) > MOST_STATES:
        raise UsageError(f"the model has {len(field.states)} states; at most {MOST_STATES} can be analysed")
    flow, coefficients = Flow.of(field, inputs), Coefficients.of(field)
    varied, parameter = (flow, None) if vary is None else coefficients.find(flow, vary[0])
    spread = spread or Spread()
    fixed = fixed_points(flow, box)
    cycles = limit_cycles(flow, box, fixed.points, fixed.sets, spread)
    stable: list[Attractor] = [point for point in (*fixed.points, *cycles.resting) if point.attracts_in_box]
    stable += [fixed_set for fixed_set in fixed.sets if fixed_set.attracts_in_box]
    stable += [cycle for cycle in cycles.cycles if cycle.is_stable]
    found = _FoundDynamics(
        flow, box, tuple(stable), cycles.unsettled, cycles.cycles, varied, parameter, None if vary is None else vary[1]
    )
    is_open = flow.size > 2 and len(cycles.unsettled) > 0
    parts: list[_Part] = ["continuation"] if vary is not None else []
    parts += ["lyapunov", "basins"] if is_open else ["basins"]
    computed = dict(zip(parts, spread.map(_PARTS, lambda: found, parts), strict=True))
    reached, branched = computed["basins"], computed.get("continuation") or _Branches()
    spectrum = computed.get("lyapunov")
    assert isinstance(reached, Basins)
    assert isinstance(branched, _Branches)
    assert spectrum is None or isinstance(spectrum, LyapunovSpectrum)
    return Analysis(
        field,
        box,
        flow.inputs,
        fixed,
        nullclines(flow, box) if flow.size == 2 else (),
        cycles,
        spectrum,
        reached,
        conserved_quantities(flow, box),
        is_volume_preserving(flow, box),
        compare(flow, box, stable, measured, reached.duration, has_family=cycles.has_family),
        coefficients,
        parameter,
        branched.fixed_points,
        branched.cycles,
        tuple(trajectory.name for trajectory in measured if field.inputs and trajectory.inputs is None),
    )


@dataclass(frozen=True, eq=False)
class _Branches:
    """Branches of fixed points and of limit cycles."""

    fixed_points: tuple[Branch, ...] = ()
    cycles: tuple[CycleBranch, ...] = ()


_Part = Literal["basins", "lyapunov", "continuation"]
"""The parts of an analysis that take up to seconds and do not need each other."""


@dataclass(frozen=True, eq=False)
class _FoundDynamics:
    """What the parts of an analysis need: the stable attractors, the `unsettled` states (n, D) and the `cycles`.

    The `parameter` of the flow `varied` is followed over `bounds`; both are None without a parameter.
    """

    flow: Flow
    box: Box
    stable: tuple[Attractor, ...]
    unsettled: FloatArray
    cycles: tuple[LimitCycle, ...]
    varied: Flow
    parameter: ContinuationParameter | None
    bounds: tuple[float, float] | None

    @np.errstate(all="ignore")
    def compute(self, part: _Part) -> Basins | LyapunovSpectrum | _Branches | None:
        """Return a part of the analysis."""
        if part == "basins":
            return basins(self.flow, self.box, self.stable)
        if part == "lyapunov":
            return lyapunov_spectrum(self.flow, self.box, self.unsettled)
        assert self.parameter is not None
        assert self.bounds is not None
        return _continue_branches(self.box, self.varied, self.parameter, self.bounds, self.cycles)


_PARTS: Final = BatchFunction(
    "dynamics", _FoundDynamics, _Part, Basins | LyapunovSpectrum | _Branches | None, _FoundDynamics.compute
)


def _continue_branches(
    box: Box, flow: Flow, parameter: ContinuationParameter, bounds: tuple[float, float], cycles: Sequence[LimitCycle]
) -> _Branches:
    branches = continuation(flow, box, parameter, bounds)
    value = parameter.value
    if not bounds[0] <= value <= bounds[1]:
        value = 0.5 * (bounds[0] + bounds[1])
        shifted = parameter.at(flow, value)
        shifted_points = fixed_points(shifted, box)
        cycles = limit_cycles(shifted, box, shifted_points.points, shifted_points.sets).cycles
    known = [(value, cycle) for cycle in cycles]
    return _Branches(branches, cycle_continuation(flow, box, parameter, bounds, branches=branches, known=known))


def analyse_model(
    model: ModelCore,
    box: Mapping[str, tuple[float, float]] | None = None,
    *,
    inputs: Mapping[str, float] | None = None,
    vary: tuple[str, tuple[float, float]] | None = None,
    spread: Spread | None = None,
) -> Analysis:
    """Return the dynamics of a model; see `atoll.Model.analyse`."""
    model.require_one_group()
    bounds = {name: interval(ends, f"the bounds of {name!r}") for name, ends in by_name(box, "the box").items()}
    held = {name: number(value, f"the input {name!r}") for name, value in by_name(inputs, "inputs").items()}
    if vary is not None and not (isinstance(vary, tuple) and len(vary) == 2 and isinstance(vary[0], str)):
        raise UsageError(f"vary must be a name and a range, such as ('c1', (0.0, 1.0)), but {shown(vary)} was given")
    varied = None if vary is None else (vary[0], interval(vary[1], f"the range of {vary[0]!r}"))
    field = model.field
    for name in held:
        if name not in field.inputs:
            raise UsageError(f"there is no input '{name}'; the inputs are {', '.join(field.inputs) or 'none'}")
    values = np.array([held.get(name, 0.0) for name in field.inputs])
    measured = measured_trajectories(model.result, field)
    sides = [equation.lhs for equation in model.result.equations if equation.verdict == "no model"]
    caveat = f'The verdict on {", ".join(sides)} is "no model": these equations do not fit the data.' if sides else ""
    searched = box_of(model.result, field, measured, bounds)
    found = analyse(field, searched, inputs=values, measured=measured, vary=varied, spread=spread)
    return replace(found, caveat=caveat)


def box_of(
    result: Result,
    field: VectorField,
    measured: Sequence[MeasuredTrajectory],
    bounds: Mapping[str, tuple[float, float]],
) -> Box:
    """Return the box to search: the `bounds` of each state, by default the measured range.

    The measured range is widened by half its width on either side, but not below 0 if no negative value was measured.
    Raises UsageError for a state with neither bounds nor measurements.
    """
    ranges = {name: ends for name, ends in result.ranges.items() if name in field.states}
    if measured:
        states = np.vstack([trajectory.states for trajectory in measured])
        ends = zip(states.min(axis=0).tolist(), states.max(axis=0).tolist(), strict=True)
        ranges |= dict(zip(field.states, ends, strict=True))
    known: dict[str, tuple[float, float]] = {}
    for name, (low, high) in ranges.items():
        # a state with only one measured value is widened by half that value, or by 1 if it is 0
        beyond = _MARGIN * (high - low) or _MARGIN * abs(high) or 1.0
        known[name] = (max(low - beyond, 0.0) if low >= 0.0 else low - beyond, high + beyond)
    for name in bounds:
        if name not in field.states:
            hint = did_you_mean(name, field.states)
            raise UsageError(f"the box has '{name}', but the states are {', '.join(field.states)}{hint}")
    known |= bounds
    for name in field.states:
        if name not in known:
            raise UsageError(f"state '{name}' was not measured; give its lower and upper bound in the box")
        low, high = known[name]
        if not (np.isfinite([low, high]).all() and low < high):
            raise UsageError(f"the bounds {low:g} and {high:g} of '{name}' are not an interval; give the lower first")
    lower, upper = np.array([known[name] for name in field.states], dtype=np.float64).T.copy()
    return Box(lower, upper)
