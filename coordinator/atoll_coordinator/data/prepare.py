"""From a raw table to the regression problems of a job: the stages of preparation, in order. Pure.

1. Roles of columns, trajectories, and checks of the columns (`examine`).
2. Smoothing and differentiation; again where gaps in the times split trajectories, and again where there are far more
   rows than the states' time scales need, which are then averaged.
3. Selection of rows, the `Dataset` of the search and the recording.

A stochastic process is not smoothed, and given left-hand sides are not differentiated.
"""

from dataclasses import replace

from atoll_coordinator.data.assembly import assemble_differentiated, assemble_given
from atoll_coordinator.data.columns.examination import Examination, examine
from atoll_coordinator.data.differentiation.derivatives import Differentiation
from atoll_coordinator.data.differentiation.held_inputs import estimate_driven_states
from atoll_coordinator.data.increments import assemble_process
from atoll_coordinator.data.prior_knowledge import resolve_equations
from atoll_coordinator.data.recording import Preparation, Source
from atoll_coordinator.data.roles.roles import assign_symbols
from atoll_coordinator.data.row_selection.row_means import average_oversampled_rows, estimates_of_means
from atoll_coordinator.data.row_selection.selected_rows import (
    normalize_weights,
    select_rows,
    select_weighty_rows,
    thin_searched_rows,
)
from atoll_coordinator.data.trajectories.measurements import split_at_gaps
from atoll_core.config import JobConfig
from atoll_core.data.table import Table


def prepare(table: Table, config: JobConfig) -> Preparation:
    """Return the regression problems that `table` holds under `config`, and the recording that they come from.

    Raises UsageError where options contradict each other, DataError where the measurements cannot be used.
    """
    examination = examine(table, config)
    roles, options = examination.roles, examination.options
    units = {name: unit for name, unit in zip(table.names, table.units, strict=True) if unit} | options.units
    role_values = (roles.time, roles.states, roles.velocities, roles.inputs, roles.target, roles.order)
    source = Source(table.digest, table.files, table.rows, units, *role_values, table.read_as)
    return replace(_prepare(examination, config), source=source)


def _prepare(examination: Examination, config: JobConfig) -> Preparation:
    roles, options, measurements = examination.roles, examination.options, examination.measurements
    symbols = assign_symbols(roles.variables)
    _, equations = resolve_equations(config.model_copy(update={"data": options}), roles, symbols)

    if options.stochastic:
        return assemble_process(measurements, equations, symbols)
    weights = normalize_weights(measurements.weights)
    if measurements.trajectories is None:
        rows = select_weighty_rows(weights, measurements.searched_rows)
        return assemble_given(measurements, weights, rows, equations, symbols)

    differentiation = Differentiation(options.order, config.preset == "paper", options.robust)
    whole, estimates = measurements, estimate_driven_states(measurements, weights, differentiation)
    measurements = split_at_gaps(whole, max(estimate.span for estimate in estimates))
    if measurements.ranges != whole.ranges:
        weights = normalize_weights(measurements.weights)
        estimates = estimate_driven_states(measurements, weights, differentiation)
    if not differentiation.paper:
        sampled = measurements
        measurements = average_oversampled_rows(sampled, estimates)
        if measurements is not sampled:
            weights = normalize_weights(measurements.weights)
            estimates = estimates_of_means(estimate_driven_states(measurements, weights, differentiation), estimates)

    selected = select_rows(measurements, estimates, paper=differentiation.paper)
    if not differentiation.paper:
        selected = thin_searched_rows(selected, [estimate.values for estimate in estimates])
    return assemble_differentiated(measurements, weights, estimates, selected, equations, symbols)
