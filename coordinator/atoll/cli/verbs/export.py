"""``coordinator export``: the model of a saved result in the formats of other programs."""

import argparse
from collections.abc import Mapping
from pathlib import Path

from atoll.cli.exit_codes import DONE
from atoll.cli.verbs.models import chosen_times, deliver, held_inputs, load, start_of
from atoll.model.model import Model
from atoll.terminal.output import note
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError


def export(options: argparse.Namespace) -> int:
    """Write the model of ``options.result`` in ``options.format``. Return the exit code."""
    from atoll.export.describing import describe
    from atoll.export.formats import LANGUAGES, OF_RESULTS, PETAB, write

    if options.format == PETAB:
        model = _chosen(load(options), options)
        if options.output is None:
            raise UsageError("petab is a folder of several files; name it with -o FOLDER")
        model.to_petab(options.output, None if options.data is None else _trajectories(model, options.data))
        return DONE
    if options.data is not None:
        raise UsageError("--data belongs to --format petab, which holds measurements; leave it out")
    if options.format in OF_RESULTS:
        deliver(OF_RESULTS[options.format](_result(options)), options.output)
        return DONE
    model = _chosen(load(options), options)
    language = LANGUAGES[options.format]
    description = describe(model, *_beginning(model, options), language.without_tables)
    deliver(write(description, language), options.output)
    for sentence in description.zeros:
        note(f"coordinator: {sentence}; give --hold{' or --initial FILE' if language.has_tables else ''}")
    return DONE


def _result(options: argparse.Namespace) -> Result:
    """Return the result, which need not be a model unless a group or other equations are chosen."""
    if options.group is None and options.candidate is None and not options.pick:
        return Result.load(options.result)
    return _chosen(load(options), options).result


def _chosen(model: Model, options: argparse.Namespace) -> Model:
    """Return the model that is asked for: the one that was selected, members of fronts, or a candidate."""
    if options.pick and options.candidate is not None:
        raise UsageError("--pick and --candidate both choose equations; give one of them")
    if options.candidate is not None:
        number: int = options.candidate
        candidates = model.candidates
        if number > len(candidates):
            raise UsageError(f"--candidate {number} is not there: the result has {len(candidates)} candidates")
        return candidates[number - 1]
    if options.pick:
        from atoll.text.render import parse_picks, pick

        kept = {"simulation": model.result.simulation}  # where a simulation begins belongs to the data
        picked = pick(model.result, parse_picks(options.pick))
        return Model(picked.model_copy(update={**kept, "covariance": None}))
    return model


def _beginning(
    model: Model, options: argparse.Namespace
) -> tuple[Mapping[str, float] | None, FloatArray | None, dict[str, FloatArray | float] | None]:
    """Return initial state, times and inputs, as far as options tell them."""
    if model.is_regression:
        return None, None, None
    start = start_of(model, options.initial)
    is_told = options.until is not None or options.step is not None or start.times is not None
    times = chosen_times(model, start, options) if is_told else None
    inputs = {} if times is None else start.inputs(times)
    return start.state, times, {**inputs, **held_inputs(model, options)}


def _trajectories(model: Model, files: list[str]) -> list[Mapping[str, FloatArray]]:
    """Return the measured columns of files, trajectory by trajectory, read as the result's own were."""
    from atoll_coordinator.data.reading.files import read_table
    from atoll_coordinator.data.roles.roles import assign_roles
    from atoll_coordinator.data.trajectories.measurements import take_measurements
    from atoll_core.config import DataConfig

    config = DataConfig.model_validate(model.result.data_settings)
    table = read_table([Path(file) for file in files], config)
    roles, config = assign_roles(table, config)
    measured = take_measurements(table, roles, config)
    return [{name: column[first:last] for name, column in measured.columns.items()} for first, last in measured.ranges]
