"""The verbs that take the model of a result, saved or a job's: ``simulate``, ``analyse``, ``suggest``, ``export``."""

import argparse
import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

from atoll.cli.exit_codes import DONE
from atoll.cli.options.values import finite_number, if_given, interval, intervals, numbers, whole_number
from atoll.cli.request import result_of
from atoll.model.arguments import FileStart, ReadColumns, start_of_file, times_until
from atoll.model.files import write_text
from atoll.model.model import Model
from atoll.model.simulation import SimulationWarning
from atoll.terminal.output import as_json, note, say
from atoll_coordinator.data.differentiation.inputs import InputCurve
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError


def simulate(options: argparse.Namespace) -> int:
    """Simulate the model of ``options.result``, or draw paths; how it ends is said on stderr. Return the exit code."""
    model = _load(options)
    if model.is_regression:
        raise UsageError("the model is a regression without time, so there is nothing to simulate; see its result")
    start = _start_of(model, options.initial)
    times = _chosen_times(model, start, options)
    inputs: dict[str, InputCurve | float] = {**start.inputs, **_held_inputs(model, options)}
    paths, seed = _paths(options)
    if paths is not None:
        with warnings.catch_warnings(record=True) as told:
            ensemble = model.simulate(start.state, times, inputs, paths=paths, seed=seed)
        for each in told:
            note(f"coordinator: warning: {each.message}")
        is_each = options.each_path
        text = as_json(ensemble.as_dict(has_paths=is_each)) if options.json else ensemble.to_csv(has_paths=is_each)
        deliver(text, options.output)
        if len(ensemble.finite) < paths:
            note(f"coordinator: {ensemble.message}")
        return DONE
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SimulationWarning)  # each is said in a line of its own
        simulation = model.simulate(start.state, times, inputs)
    deliver(as_json(simulation.as_dict()) if options.json else simulation.to_csv(), options.output)
    if model.result.process is not None:
        note("coordinator: the drift was simulated, without the noise of the process; --paths draws paths with it")
    if simulation.remark:
        note(f"coordinator: warning: {simulation.remark}")
    if simulation.status != "finished":
        note(f"coordinator: the simulation ended early: {simulation.message}")
    return DONE


def _paths(options: argparse.Namespace) -> tuple[int | None, int]:
    """Return how many paths are to be drawn, None for a simulation, and their seed; raises UsageError."""
    paths = if_given(whole_number, options.paths, "--paths")
    seed = if_given(whole_number, options.seed, "--seed")
    if paths is None and (options.each_path or seed is not None):
        option = "--each-path" if options.each_path else "--seed"
        raise UsageError(f"{option} belongs to --paths; say how many there are")
    return paths, seed or 0


def analyse(options: argparse.Namespace) -> int:
    """Analyse the model of ``options.result``. Return the exit code."""
    from atoll.cli.analyses import ask
    from atoll.tasks.analyses import Analyse, Form, Profile, Question

    vary = _vary(options.parameter, options.range)
    bounds, held = intervals(options.box, "--box"), numbers(options.hold, "--hold", "u=1")
    if options.data is not None and not options.identifiability:
        raise UsageError("--data was given without --identifiability, which alone uses it; give both")
    form: Form = "json" if options.json else "text"
    questions: list[Question] = [Analyse(box=bounds, inputs=held, vary=vary, form=form)]
    if options.identifiability:
        questions.append(Profile(form=form))
    texts = [answered.text for answered in ask(options, *questions)]
    if options.json:
        analysis, *known = map(json.loads, texts)
        text = as_json(analysis | {"identifiability": known[0] if known else None})
    else:
        text = "\n".join(texts)
    deliver(text, options.output)
    return DONE


def _vary(parameter: str | None, bounds: str | None) -> tuple[str, tuple[float, float]] | None:
    if parameter is None and bounds is None:
        return None
    if parameter is None or bounds is None:
        given, missing = ("--range", "--parameter c1") if parameter is None else ("--parameter", "--range A:B")
        raise UsageError(f"{given} was given without {missing}; give both")
    return parameter, interval(bounds, "--range")


def suggest(options: argparse.Namespace) -> int:
    """Suggest experiments for ``options.result``. Return the exit code."""
    from atoll.cli.analyses import ask
    from atoll.experiments.designs import DesignRequest
    from atoll.tasks.analyses import Suggest

    request = DesignRequest(
        bounds=intervals(options.box, "--box"),
        duration=if_given(finite_number, options.duration, "--duration"),
        samples=if_given(whole_number, options.samples, "--samples"),
        cost=options.cost,
        count=whole_number(options.count, "--count"),
        rivals=[_rival(text) for text in options.rival],
        seed=whole_number(options.seed, "--seed"),
    )
    (suggested,) = ask(options, Suggest(request=request, form="json" if options.json else "text"))
    deliver(suggested.text, options.output)
    return DONE


def _rival(text: str) -> dict[str, str]:
    """Split ``dx=EXPR; dy=EXPR`` into right-hand sides by left-hand side."""
    equations: dict[str, str] = {}
    for equation in filter(None, (part.strip() for part in text.split(";"))):
        side, separator, right = (part.strip() for part in equation.partition("="))
        if not separator or not side or not right:
            raise UsageError(f"--rival wants dx=EXPR, several separated by ';', but got {text!r}")
        equations[side] = right
    if not equations:
        raise UsageError("--rival wants dx=EXPR, but got nothing")
    return equations


def export(options: argparse.Namespace) -> int:
    """Write the model of ``options.result`` in ``options.format``. Return the exit code."""
    from atoll.export.description import describe
    from atoll.export.formats import LANGUAGES, OF_RESULTS, PETAB, write

    if options.format == PETAB:
        model = _chosen(_load(options), options)
        if options.output is None:
            raise UsageError("petab is a folder of several files; name it with -o FOLDER")
        model.to_petab(options.output, None if options.data is None else _trajectories(model, options.data))
        return DONE
    if options.data is not None:
        raise UsageError("--data belongs to --format petab, which holds measurements; leave it out")
    if options.format in OF_RESULTS:
        deliver(OF_RESULTS[options.format](_result(options)), options.output)
        return DONE
    model = _chosen(_load(options), options)
    language = LANGUAGES[options.format]
    description = describe(model, *_beginning(model, options), language.without_tables)
    deliver(write(description, language), options.output)
    for sentence in description.zeros:
        note(f"coordinator: {sentence}; give --hold{' or --initial FILE' if language.has_tables else ''}")
    return DONE


def _result(options: argparse.Namespace) -> Result:
    """Return the result, which need not be a model unless a group or other equations are chosen."""
    if options.group is None and options.candidate is None and not options.pick:
        return result_of(options.result, options)
    return _chosen(_load(options), options).result


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

        begun = {"simulation": model.result.simulation}  # where a simulation begins belongs to the data
        return Model(pick(model.result, parse_picks(options.pick)).model_copy(update=begun))
    return model


def _beginning(
    model: Model, options: argparse.Namespace
) -> tuple[Mapping[str, float] | None, FloatArray | None, dict[str, InputCurve | float] | None]:
    """Return initial state, times and inputs, as far as options tell them."""
    if model.is_regression:
        return None, None, None
    start = _start_of(model, options.initial)
    is_told = options.until is not None or options.step is not None or start.times is not None
    times = _chosen_times(model, start, options) if is_told else None
    return start.state, times, {**start.inputs, **_held_inputs(model, options)}


def _trajectories(model: Model, files: list[str]) -> list[ReadColumns]:
    """Return the measured columns of files, trajectory by trajectory, read as the result's own were."""
    from atoll_coordinator.data.columns.examination import examine
    from atoll_coordinator.data.reading.files import read_table
    from atoll_core.config import DataConfig, JobConfig

    config = DataConfig.model_validate(model.result.data_settings)
    table = read_table([Path(file) for file in files], config)
    examination = examine(table, JobConfig(data=config))
    roles, measured = examination.roles, examination.measurements
    unwrapped: dict[str, Sequence[FloatArray]] = dict(zip(roles.inputs, measured.inputs, strict=True))
    if measured.trajectories is not None:
        unwrapped |= measured.trajectories.states
    plain = [{name: column[first:last] for name, column in measured.columns.items()} for first, last in measured.ranges]
    parts = [part | {name: along[place] for name, along in unwrapped.items()} for place, part in enumerate(plain)]
    return [ReadColumns(part) for part in parts]


def _load(options: argparse.Namespace) -> Model:
    """Return the model of ``options.result``, that of ``options.group`` if named; raises UsageError."""
    model = Model(result_of(options.result, options))
    return model if options.group is None else model.of_group(options.group)


def _start_of(model: Model, text: str | None) -> FileStart:
    """Return what ``--initial`` says: numbers by name, or a data file; raises UsageError or DataError."""
    if text is None:
        return FileStart()
    if Path(text).is_file():
        return start_of_file(model, Path(text))
    if "=" not in text:
        raise UsageError(f"--initial wants numbers such as x=1,y=3 or a data file, and {text!r} is neither")
    return FileStart(numbers([text], "--initial", "NAME=NUMBER, separated by commas"))


def _chosen_times(model: Model, start: FileStart, options: argparse.Namespace) -> FloatArray:
    """Return the times that ``--until`` and ``--step`` choose; raises UsageError where nothing tells them."""
    end = if_given(finite_number, options.until, "--until")
    return times_until(model, start, end, if_given(finite_number, options.step, "--step"))


def _held_inputs(model: Model, options: argparse.Namespace) -> dict[str, float]:
    """Return the inputs that ``--hold`` gives, by symbol; raises UsageError."""
    held, symbols = numbers(options.hold, "--hold", "u=1"), model.result.symbols
    unknown = next((name for name in held if symbols.get(name, name) not in model.inputs), None)
    if unknown is not None:
        raise UsageError(f"--hold names {unknown!r}; the inputs are {', '.join(model.inputs) or 'none'}")
    return {symbols.get(name, name): value for name, value in held.items()}


def deliver(text: str, output: str | None) -> None:
    """Write a text with a newline at its end to the file `output`, or on stdout; raises UsageError."""
    if output is None:
        say(text)
    else:
        write_text(output, text.removesuffix("\n") + "\n")
