"""What verbs on a saved result have in common: its model, what options say of a simulation, where the output goes."""

import argparse
from pathlib import Path

from atoll.cli.options.values import finite_number, numbers
from atoll.model.model import Model
from atoll.model.saved import write_text
from atoll.model.start import Start, start_of_file, times_of
from atoll.terminal.output import say
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError


def load(options: argparse.Namespace) -> Model:
    """Return the model of ``options.result``, that of ``options.group`` if named; raises UsageError."""
    model = Model.load(options.result)
    return model if options.group is None else model.of_group(options.group)


def start_of(model: Model, text: str | None) -> Start:
    """Return what ``--initial`` says: numbers by name, or a data file; raises UsageError or DataError."""
    if text is None:
        return Start()
    if Path(text).is_file():
        return start_of_file(model, Path(text))
    if "=" not in text:
        raise UsageError(f"--initial wants numbers such as x=1,y=3 or a data file, and {text!r} is neither")
    return Start(numbers([text], "--initial", "NAME=NUMBER, separated by commas"))


def chosen_times(model: Model, start: Start, options: argparse.Namespace) -> FloatArray:
    """Return the times that ``--until`` and ``--step`` choose; raises UsageError where nothing tells them."""
    end = None if options.until is None else finite_number(options.until, "--until")
    step = None if options.step is None else finite_number(options.step, "--step")
    return times_of(model, start, end, step)


def held_inputs(model: Model, options: argparse.Namespace) -> dict[str, float]:
    """Return the inputs that ``--hold`` gives, by symbol; raises UsageError."""
    held, symbols = numbers(options.hold, "--hold", "u=1"), model.result["symbols"]
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
