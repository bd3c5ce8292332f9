"""Systems of given forms with named parameters, and measurements of some of their states."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from atoll_coordinator.model.shooting.measurements import InitialRanges, TrajectoryMeasurements
from atoll_coordinator.model.shooting.system import OdeSystem, Place, system_of
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import CONSTANT, VARIABLE
from atoll_core.expression.text.parsing import from_infix

Bounds = tuple[float, float]
FREE = (-np.inf, np.inf)


def given_system(
    sides: Mapping[str, str], states: Sequence[str], parameters: Mapping[str, Bounds], inputs: Sequence[str] = ()
) -> tuple[OdeSystem, list[str]]:
    """Return the system of `sides`, first of the states, then of columns; and the name of each fitted number.

    Parameters with bounds of one sign are fitted in logarithms, and begin in the middle of their bounds.
    """
    names, fitted = (*states, *inputs), list(parameters)
    programs, fixed = [], []
    places: dict[str, list[Place]] = {name: [] for name in fitted}
    for index, text in enumerate(sides.values()):
        program = from_infix(text, (*names, *fitted), merges_constants=False)
        fixed.append(set(np.flatnonzero(program.operators == CONSTANT).tolist()))
        is_parameter = (program.operators == VARIABLE) & (program.left >= len(names))
        for node in np.flatnonzero(is_parameter).tolist():
            places[fitted[program.left[node] - len(names)]].append((index, node))
        codes, left = np.where(is_parameter, CONSTANT, program.operators), np.where(is_parameter, 0, program.left)
        constants = np.where(is_parameter, 1.0, program.constants)
        programs.append(
            replace(program, operators=codes.astype(np.int8), left=left.astype(np.int16), constants=constants)
        )
    system = system_of(programs, names, names, fixed, observations=len(sides) - len(states))
    shared = [tuple((place, 1.0) for place in those) for those in places.values()]
    system = system.sharing_numbers(system.constants[None], shared)
    numbers = [""] * system.count
    for name, (place, *_) in places.items():
        node = system.firsts[place[0]] + place[1]
        numbers[int(system.columns[0, system.places.tolist().index(node)])] = name
    lower, upper = np.array([parameters[name] for name in numbers]).T.copy()
    system = replace(system, lower=lower, upper=upper).in_logarithms()
    return system.with_values(np.where(np.isinf(upper - lower), 1.0, middle_of(lower, upper))), numbers


def measured_columns(
    values: FloatArray, times: FloatArray, names: Sequence[str], noise: FloatArray | float
) -> TrajectoryMeasurements:
    """Return the measurements of one trajectory of columns (O, N)."""
    return TrajectoryMeasurements(
        bounds=np.array([[0, len(times)]]), owners=np.zeros(1, np.int64), times=times, measured=values,
        weights=np.ones_like(values), smoothed=values, observed=np.arange(len(values)),
        inputs=np.zeros((0, len(times))), input_slopes=np.zeros((0, len(times))), scales=values.std(axis=1),
        noise=np.broadcast_to(noise, len(values)), offset=np.zeros(0, np.int64), variables=tuple(names), names=("1",),
    )  # fmt: skip


def ranges(times: FloatArray, *bounds: Bounds) -> InitialRanges:
    """Return the bounds of the initial state of one trajectory."""
    lower, upper = np.array(bounds).T
    return InitialRanges(times[:1], lower[None], upper[None])


def for_states(
    columns: TrajectoryMeasurements,
    states: Sequence[str],
    observed: Sequence[int],
    initial: InitialRanges | None = None,
) -> TrajectoryMeasurements:
    """Return the measurements of `columns` for a system of D states.

    `observed` has for each column the index of its state; indices from D on are computed columns. Other states are
    hidden: their course is the middle of the bounds on their initial values, or 0.
    """
    places = np.array(observed, np.int64)
    is_state = places < len(states)
    smoothed, scales = np.zeros((len(states), columns.rows)), np.ones(len(states))
    smoothed[places[is_state]], scales[places[is_state]] = columns.smoothed[is_state], columns.scales[is_state]
    made = replace(
        columns, smoothed=smoothed, observed=places, scales=scales, initial=initial,
        hidden=tuple(index for index in range(len(states)) if index not in observed),
        variables=(*states, *columns.variables[len(columns.smoothed) :]),
        column_scales=None if is_state.all() else columns.scales,
    )  # fmt: skip
    if initial is None:
        return made.with_course(np.zeros_like(smoothed))
    return made.with_course(middle_of(initial.lower, initial.upper)[columns.owners_of_rows].T)


def middle_of(lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return the middle of bounds: the geometric mean of bounds of equal sign, else the mean. An infinite bound is
    left out; between two of them, the middle is 0."""
    with np.errstate(all="ignore"):
        means = np.where(lower * upper > 0.0, np.sign(lower) * np.sqrt(lower * upper), 0.5 * (lower + upper))
    ends = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper, 0.0))
    return np.asarray(np.where(np.isfinite(means), means, ends))
