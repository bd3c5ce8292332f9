"""``coordinator simulate``: what the model of a saved result does from an initial state, as CSV or JSON."""

import argparse
import warnings

from atoll.cli.exit_codes import DONE
from atoll.cli.options.values import whole_number
from atoll.cli.saved_model import chosen_times, deliver, held_inputs, load, start_of
from atoll.model.simulation import EarlyEndWarning
from atoll.terminal.output import as_json, note
from atoll_core.errors import UsageError


def simulate(options: argparse.Namespace) -> int:
    """Simulate the model of ``options.result``, or draw paths; how it ends is said on stderr. Return the exit code."""
    model = load(options)
    if model.is_regression:
        raise UsageError("the model is a regression without time, so there is nothing to simulate; see its result")
    start = start_of(model, options.initial)
    times = chosen_times(model, start, options)
    inputs = start.inputs(times) | held_inputs(model, options)
    paths, seed = _paths(options)
    if paths is not None:
        ensemble = model.simulate(start.state, times, inputs, paths=paths, seed=seed)
        is_each = options.each_path
        text = as_json(ensemble.as_dict(has_paths=is_each)) if options.json else ensemble.to_csv(has_paths=is_each)
        deliver(text, options.output)
        if len(ensemble.finite) < paths:
            note(f"coordinator: {ensemble.message}")
        return DONE
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EarlyEndWarning)  # said in a line of its own
        simulation = model.simulate(start.state, times, inputs)
    deliver(as_json(simulation.as_dict()) if options.json else simulation.to_csv(), options.output)
    if model.result.get("process") is not None:
        note("coordinator: the drift was simulated, without the noise of the process; --paths draws paths with it")
    if simulation.status != "finished":
        note(f"coordinator: the simulation ended early: {simulation.message}")
    return DONE


def _paths(options: argparse.Namespace) -> tuple[int | None, int]:
    """Return how many paths are to be drawn, None for a simulation, and their seed; raises UsageError."""
    paths, seed = (
        None if text is None else whole_number(text, option)
        for text, option in ((options.paths, "--paths"), (options.seed, "--seed"))
    )
    if paths is None and (options.each_path or seed is not None):
        option = "--each-path" if options.each_path else "--seed"
        raise UsageError(f"{option} belongs to --paths; say how many there are")
    return paths, seed or 0
