"""The verbs about a saved result or the result of a job: ``result``, ``report``, ``compare``, ``simulate``, ``smooth``,
``forecast``, ``analyse``, ``suggest`` and ``export``.

Analyses of a saved result run in this process; analyses of a coordinator's job run on a worker. `ask` handles both
cases. Modules that only some verbs need are imported in their functions, because ``coordinator result`` should print at
once.
"""

import argparse
import json
import re
import shlex
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from atoll.api.model import Model
from atoll.cli.exit_codes import DONE
from atoll.cli.parser import finite_number, if_given, interval, intervals, natural_number, numbers
from atoll.cli.request import CONNECT_LIMIT_S, address_of, is_saved, load_result, result_of
from atoll.cli.result_files import REPORT, write_page
from atoll.client.client import connected
from atoll.model.arguments import FileStart, ReadColumns, inputs_of_file, start_of_file, times_until
from atoll.model.simulation import SimulationWarning
from atoll.terminal.output import as_json, note, say
from atoll_coordinator.data.differentiation.inputs import InputCurve
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import AtollError, UsageError
from atoll_core.quoting import write_text
from atoll_core.wire.values import encode_value

if TYPE_CHECKING:
    from atoll.tasks.analyses import Analysed, Question


def result(options: argparse.Namespace) -> int:
    """Print the result of ``options.job``, which is a job's id or a saved result; for a running job, print the best
    result so far."""
    from atoll.text.render import parse_picks, pick, render, render_text

    if options.json and options.format not in (None, "json"):
        raise UsageError(f"--json and --format {options.format} contradict each other; give one of them")
    found = result_of(options.job, options)
    if options.pick:
        found = pick(found, parse_picks(options.pick))
    if options.json or options.format == "json":
        say(as_json(found.as_dict()))
    elif options.format in (None, "text"):
        reason = f": {found.reason}" if found.reason else ""
        heading = "" if found.state == "done" else f"job {found.job} is {found.state}{reason}\n"
        say(heading + render_text(found, fronts=True))
    else:
        say(render(found, options.format))
    return DONE


# ------------------------------------------------------------------------------------------- simulate


def simulate(options: argparse.Namespace) -> int:
    """Simulate the model of ``options.result`` or draw paths; print warnings and reasons of an early end on stderr."""
    model = _load(options)
    if model.is_regression:
        raise UsageError("the model is a regression without time, so there is nothing to simulate; see its result")
    start = _initial_state(model, options.initial)
    times = _chosen_times(model, start, options)
    inputs: dict[str, InputCurve | float] = {**start.inputs, **_held_inputs(model, options)}
    paths = if_given(natural_number, options.paths, "--paths")
    seed = if_given(natural_number, options.seed, "--seed")
    if paths is None and (options.each_path or seed is not None):
        option = "--each-path" if options.each_path else "--seed"
        raise UsageError(f"{option} needs --paths; add the number of paths, as in --paths 100")
    if paths is not None:
        with warnings.catch_warnings(record=True) as raised:
            ensemble = model.simulate(start.state, times, inputs, paths=paths, seed=seed or 0)
        for warning in raised:
            note(f"coordinator: warning: {warning.message}")
        is_each = options.each_path
        text = as_json(ensemble.as_dict(has_paths=is_each)) if options.json else ensemble.to_csv(has_paths=is_each)
        deliver(text, options.output)
        if len(ensemble.finite) < paths:
            note(f"coordinator: {ensemble.message}")
        return DONE
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SimulationWarning)  # printed below, one per line
        simulation = model.simulate(start.state, times, inputs)
    deliver(as_json(simulation.as_dict()) if options.json else simulation.to_csv(), options.output)
    if model.result.process is not None:
        note(
            "coordinator: the drift was simulated without the noise of the process; --paths N draws N paths with noise"
        )
    if simulation.remark:
        note(f"coordinator: warning: {simulation.remark}")
    if simulation.status != "finished":
        note(f"coordinator: the simulation ended early: {simulation.message}")
    return DONE


def _initial_state(model: Model, text: str | None) -> FileStart:
    """Return the initial state of ``--initial``: numbers by name, or a data file; raises UsageError or DataError."""
    if text is None:
        return FileStart()
    if Path(text).is_file():
        return start_of_file(model, Path(text))
    if "=" not in text:
        raise UsageError(f"--initial must be numbers such as x=1,y=3 or a data file, but {text!r} was given")
    return FileStart(numbers([text], "--initial", "NAME=NUMBER, separated by commas"))


def _chosen_times(model: Model, start: FileStart, options: argparse.Namespace) -> FloatArray:
    end = if_given(finite_number, options.until, "--until")
    return times_until(model, start, end, if_given(finite_number, options.step, "--step"))


def _held_inputs(model: Model, options: argparse.Namespace) -> dict[str, float]:
    """Return the inputs of ``--hold`` by symbol; raises UsageError."""
    held, symbols = numbers(options.hold, "--hold", "NAME=NUMBER"), model.result.symbols
    unknown = next((name for name in held if symbols.get(name, name) not in model.inputs), None)
    if unknown is not None:
        raise UsageError(f"--hold names {unknown!r}; the inputs are {', '.join(model.inputs) or 'none'}")
    return {symbols.get(name, name): value for name, value in held.items()}


# ----------------------------------------------------------------------------------- smooth, forecast


def smooth(options: argparse.Namespace) -> int:
    """Write the states along each trajectory under the law of ``options.result``."""
    from atoll.experiments.smoothing import smooth as smooth_states

    model = _load(options)
    model.require_one_group()
    smoothed = smooth_states(model.result, _table(model, options.data))
    deliver(as_json(smoothed.as_dict()) if options.json else smoothed.to_csv(), options.output)
    for sentence in smoothed.sentences:
        note(f"coordinator: {sentence}")
    if options.picture is not None:
        from atoll.report.bands import picture_of_states

        write_text(options.picture, picture_of_states(smoothed, model.result))
    return DONE


def forecast(options: argparse.Namespace) -> int:
    """Write a forecast from the last row of ``options.result`` or of ``options.data``; print its horizon on stderr."""
    from atoll.experiments.forecast import ForecastRequest
    from atoll.experiments.forecast import forecast as forecast_states

    model = _load(options)
    request = ForecastRequest(
        duration=finite_number(options.duration, "--for"),
        trajectory=options.trajectory,
        step=if_given(finite_number, options.step, "--step"),
        draws=natural_number(options.draws, "--draws"),
        seed=natural_number(options.seed, "--seed"),
        has_rivals=not options.no_rivals,
    )
    inputs = None if options.inputs is None else inputs_of_file(model, Path(options.inputs))
    found = forecast_states(model.result, request, _table(model, options.data), inputs)
    deliver(as_json(found.as_dict()) if options.json else found.to_csv(), options.output)
    for sentence in found.sentences:
        note(f"coordinator: {sentence}")
    if options.picture is not None:
        from atoll.report.bands import picture_of_forecast

        write_text(options.picture, picture_of_forecast(found, model.result))
    return DONE


def _table(model: Model, files: list[str] | None) -> Table | None:
    """Return the measurements in `files`, read with the settings of the job; None for None."""
    from atoll.api.tables import table_of
    from atoll.model.core import config_of

    return None if files is None else table_of(files, config_of(model.result).data)


# -------------------------------------------------------------------------- analyse, suggest, report


def ask(options: argparse.Namespace, *questions: "Question", name: str | None = None) -> "list[Analysed]":
    """Return the answers to questions about the result `name` (None: `options.result`), in order.

    Measurements given with ``--data`` replace the measurements in the result.
    """
    from atoll.api.tables import table_of
    from atoll.model.core import config_of
    from atoll.tasks.analyses import FUNCTIONS, answer, answered

    name = options.result if name is None else name
    questions = tuple(replace(question, group=options.group) for question in questions)
    files: list[str] | None = getattr(options, "data", None)

    def table(found: Result) -> Table | None:
        return None if files is None else table_of(files, config_of(found).data)

    if is_saved(name, options):
        saved = load_result(name)
        measurements = table(saved)
        return [answer(saved, question, measurements) for question in questions]
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        job = client.resolve(name)
        measurements = None if files is None else table(Result.of(client.result(job)))
        rows = None if measurements is None else measurements.to_bytes()
        return [
            answered(
                client.analyse(
                    job, FUNCTIONS[type(question)], encode_value(question), rows,
                    lambda reason: note(f"coordinator: the analysis {reason}"),
                )
            )
            for question in questions
        ]  # fmt: skip


def analyse(options: argparse.Namespace) -> int:
    """Analyse the dynamics of the model of ``options.result`` and, with ``--identifiability``, how well the data
    determine its constants."""
    from atoll.tasks.analyses import AnalyseDynamics, Form, Profile, Question

    if (options.parameter is None) != (options.range is None):
        present, missing = ("--parameter", "--range A:B") if options.parameter else ("--range", "--parameter c1")
        raise UsageError(f"{present} was given without {missing}; give both")
    vary = None if options.parameter is None else (options.parameter, interval(options.range, "--range"))
    bounds, held = intervals(options.box, "--box"), numbers(options.hold, "--hold", "NAME=NUMBER")
    if options.data is not None and not options.identifiability:
        raise UsageError("--data was given without --identifiability, but only --identifiability uses data; give both")
    form: Form = "json" if options.json else "text"
    questions: list[Question] = [AnalyseDynamics(box=bounds, inputs=held, vary=vary, form=form)]
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


def suggest(options: argparse.Namespace) -> int:
    """Suggest experiments for ``options.result``."""
    from atoll.experiments.designs import DesignRequest
    from atoll.tasks.analyses import Suggest

    request = DesignRequest(
        bounds=intervals(options.box, "--box"),
        duration=if_given(finite_number, options.duration, "--duration"),
        samples=if_given(natural_number, options.samples, "--samples"),
        cost=options.cost,
        count=natural_number(options.count, "--count"),
        rivals=[_alternative(text) for text in options.rival],
        seed=natural_number(options.seed, "--seed"),
    )
    (suggested,) = ask(options, Suggest(request=request, form="json" if options.json else "text"))
    deliver(suggested.text, options.output)
    return DONE


def _alternative(text: str) -> dict[str, str]:
    """Split ``dx=EXPR; dy=EXPR`` into a mapping from left-hand to right-hand sides."""
    equations: dict[str, str] = {}
    for equation in filter(None, (part.strip() for part in text.split(";"))):
        side, separator, right = (part.strip() for part in equation.partition("="))
        if not separator or not side or not right:
            raise UsageError(f"--rival must be dx=EXPR, several separated by ';', but {text!r} was given")
        equations[side] = right
    if not equations:
        raise UsageError("--rival must be dx=EXPR, but an empty text was given")
    return equations


def report(options: argparse.Namespace) -> int:
    """Write a page for each result in ``options.result``, and its pictures if ``--pictures`` names a folder.

    If one of several results cannot be read, the other pages are written nevertheless; the first error determines the
    exit code.
    """
    paths = [Path(name) for name in options.result]
    if len(paths) == 1:
        _write_report(paths[0], options)
        return DONE
    for option, place in (("--output", options.output), ("--pictures", options.pictures)):
        if place is not None:
            raise UsageError(f"{option} names one file or folder, but {len(paths)} results were given; leave it out")
    pages = [_page(path, options) for path in paths]
    twice = next((page for page in pages if pages.count(page) > 1), None)
    if twice is not None:
        raise UsageError(f"two of these results would be written to {twice}; give them one by one, with --output")
    code = DONE
    for path in paths:
        try:
            _write_report(path, options)
        except AtollError as error:
            note(f"coordinator: {error.on_command_line}")
            code = code or error.exit_code
    return code


def _page(path: Path, options: argparse.Namespace) -> Path:
    """Return the default path of the page: next to a saved result, or in the current folder for a job."""
    if not is_saved(str(path), options):
        return Path(f"{path.name}.html")
    return (path if path.is_dir() else path.parent) / REPORT


def _write_report(path: Path, options: argparse.Namespace) -> None:
    from atoll.tasks.analyses import Report

    output = _page(path, options) if options.output is None else Path(options.output)
    (page,) = ask(options, Report(pictures=options.pictures is not None), name=str(path))
    write_page(output, page.text)
    if options.pictures is None:
        return
    folder = Path(options.pictures)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"the folder {folder} cannot be created ({error.strerror}); name another") from error
    for name, text in page.pictures.items():
        write_text(folder / name, text)
    note(f"{len(page.pictures)} pictures in {folder}")


# -------------------------------------------------------------------------------------------- compare


def compare(options: argparse.Namespace) -> int:
    """Compare the models ``options.first`` and ``options.second``."""
    from atoll.experiments.comparison import compare as compare_results

    first, number = _name_and_candidate(options.first)
    second, other = _name_and_candidate(options.second)
    if not first:
        raise UsageError(
            f"A is {options.first!r}, but the name of a result was expected, such as runs/JOB{options.first}"
        )
    models = [_candidate(name, place, options) for name, place in ((first, number), (second or first, other))]
    table = _table(models[0], options.data)
    names = (options.first, options.second if second else f"{first}{options.second}")
    comparison = compare_results(models[0].result, models[1].result, names, table)
    deliver(as_json(comparison.as_dict()) if options.json else str(comparison), options.output)
    return DONE


def _name_and_candidate(text: str) -> tuple[str, int | None]:
    """Return the name of a result and the number of its candidate (None: the displayed equations)."""
    found = re.fullmatch(r"(.*):(\d+)", text, re.DOTALL)
    if found is None or Path(text).exists():
        return text, None
    return found[1], int(found[2])


def _candidate(name: str, number: int | None, options: argparse.Namespace) -> Model:
    model = Model(result_of(name, options))
    model = model if options.group is None else model.of_group(options.group)
    if number is None:
        return model
    if not 1 <= number <= len(model.candidates):
        present = f"it has candidates 1 to {len(model.candidates)}" if model.candidates else "it has no candidates"
        raise UsageError(f"{shlex.quote(name)} has no candidate {number}: {present}")
    return model.candidates[number - 1]


# --------------------------------------------------------------------------------------------- export


def export(options: argparse.Namespace) -> int:
    """Write the model of ``options.result`` in ``options.format``."""
    from atoll.export.description import describe
    from atoll.export.formats import LANGUAGES, PETAB, RESULT_FORMATS, write

    if options.format == PETAB:
        model = _chosen_equations(_load(options), options)
        if options.output is None:
            raise UsageError("petab is a folder of several files; name the folder with -o FOLDER")
        model.to_petab(options.output, None if options.data is None else _trajectories(model, options.data))
        return DONE
    if options.data is not None:
        raise UsageError("--data was given without --format petab, the only format with measurements; leave --data out")
    if options.format in RESULT_FORMATS:
        # A result without a model is enough, unless a group or other equations are chosen.
        is_plain = options.group is None and options.candidate is None and not options.pick
        found = result_of(options.result, options) if is_plain else _chosen_equations(_load(options), options).result
        deliver(RESULT_FORMATS[options.format](found), options.output)
        return DONE
    model = _chosen_equations(_load(options), options)
    language = LANGUAGES[options.format]
    description = describe(model, *_initial_state_and_times(model, options), language.without_tables)
    deliver(write(description, language), options.output)
    for sentence in description.zeros:
        note(f"coordinator: {sentence}; give --hold{' or --initial FILE' if language.has_tables else ''}")
    return DONE


def _chosen_equations(model: Model, options: argparse.Namespace) -> Model:
    """Return the model, with the members of the fronts (``--pick``) or the candidate that the options choose."""
    if options.pick and options.candidate is not None:
        raise UsageError("--pick and --candidate both choose equations; give one of them")
    if options.candidate is not None:
        number: int = options.candidate
        candidates = model.candidates
        if number > len(candidates):
            raise UsageError(f"--candidate {number} does not exist; the result has {len(candidates)} candidates")
        return candidates[number - 1]
    if options.pick:
        from atoll.text.render import parse_picks, pick

        update = {"simulation": model.result.simulation}  # the initial state belongs to the data
        return Model(pick(model.result, parse_picks(options.pick)).model_copy(update=update))
    return model


def _initial_state_and_times(
    model: Model, options: argparse.Namespace
) -> tuple[Mapping[str, float] | None, FloatArray | None, dict[str, InputCurve | float] | None]:
    """Return the initial state, times and inputs that the options give."""
    if model.is_regression:
        return None, None, None
    start = _initial_state(model, options.initial)
    has_times = options.until is not None or options.step is not None or start.times is not None
    times = _chosen_times(model, start, options) if has_times else None
    return start.state, times, {**start.inputs, **_held_inputs(model, options)}


def _trajectories(model: Model, files: list[str]) -> list[ReadColumns]:
    """Return the measured columns of each trajectory in files, read with the data settings of the result."""
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
    """Return the model of ``options.result``, for ``options.group`` if one is named; raises UsageError."""
    model = Model(result_of(options.result, options))
    return model if options.group is None else model.of_group(options.group)


def deliver(text: str, output: str | None) -> None:
    """Write a text and a newline to the file `output` (None: stdout); raises UsageError if it cannot be written."""
    if output is None:
        say(text)
    else:
        write_text(output, text.removesuffix("\n") + "\n")
