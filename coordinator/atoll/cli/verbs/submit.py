"""``coordinator submit``; the part of ``coordinator run`` that follows the job; and the proposal of a next command."""

import argparse
import contextlib
import re
import shlex
import shutil
import sys
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final, cast

from atoll.cli.exit_codes import DONE, FAILED, INTERRUPTED, report_exit_code
from atoll.cli.request import CONNECT_LIMIT_S, JobRequest, address_of, request_of
from atoll.cli.result_files import REPORT, refuse_existing_result, write_report, write_result
from atoll.client.client import Client, connected
from atoll.client.follower import KEEPING, Display, Follower
from atoll.client.local_processes import LocalCoordinator, LocalWorkers, NoWorkerLeftError
from atoll.terminal.output import duration, note, say
from atoll.terminal.progress import is_screen, open_display, waiting
from atoll_coordinator.result.result import Result
from atoll_core.command_line import duration as seconds_of
from atoll_core.errors import UsageError
from atoll_core.signals import interrupts_held_back, raising_interrupts
from atoll_core.wire.messages.views import FINAL_STATES, JobView, Workforce

_OPTION: Final = re.compile(r"--(robust|stochastic)\b")
"""Finds options that take no value, in a warning or in the reason of a verdict."""

_ADDED: Final = re.compile(
    r"\badd --(missing-value|hold|order|per-trajectory|inputs|states)(?: ('[^']*'|[^\s;,.]\S*?))?(?=[;,.]?(?:\s|$))"
)
"""Finds options and their values in a warning about the columns."""

_WHY: Final = {
    "missing-value": "a number that stands for missing values was treated as a measured value",
    "hold": "the inputs seem to be constant between rows",
    "order": "trajectories pass the same state with different velocities",
    "per-trajectory": "a constant seems to differ between trajectories",
    "inputs": "a column, or the time, seems to be an external input",
    "states": "some columns are functions of the others",
}
"""The proposed options, the most useful first, and the reasons."""

_NOT_STOCHASTIC: Final = ("order", "target", "derivatives", "only", "robust", "weights", "offsets")
"""Settings that exclude ``--stochastic``."""

_MORE_OPERATORS: Final = "+,-,*,/,sin,cos,exp,sqrt,tanh"
_LONGER: Final = "the search ended before it had converged"
_NOT_REFINED: Final = "the time limit ended the job before equations were fitted to trajectories and compared"

_Proposal = tuple[list[str], str]
"""The words of a command line, and its purpose."""


def next_step(result: Result, folder: Path, words: Sequence[str], program: str = "coordinator") -> str | None:
    """Return the proposed next command and, after two spaces and ``#``, its purpose; None without a proposal.

    `result` is the result of a job that has ended, written into `folder`; `words` are the command line of the job, and
    `program` is how the program is called.
    """
    if result.state == "cancelled" and result.refining == "not refined":
        why = "it was interrupted before the equations were fitted to trajectories and compared"
        proposal = _without_id_and_folder(words), why
    elif result.state != "done" or not result.equations:
        return None
    else:
        proposal = (
            _again_with_columns(result, words)
            or _again_with_option(result, words)
            or _again_with_larger_budget(result, words)
            or _again_with_operators(result, words)
            or _with_result(result, str(folder))
        )
    command, purpose = proposal
    return f"{shlex.join([program, *command])}  # {purpose}"


def _again_with_option(result: Result, words: Sequence[str]) -> _Proposal | None:
    """Propose an option that a warning or a verdict names."""
    sentences = [*result.warnings, *(equation.reason or "" for equation in result.equations)]
    given = result.data_settings
    named = [match[1] for sentence in sentences for match in _OPTION.finditer(sentence)]
    is_excluded = {"robust": False, "stochastic": any(name in given for name in _NOT_STOCHASTIC)}
    free = [name for name in named if not given.get(name) and not is_excluded[name]]
    if not free:
        return None
    fitting = f"--{free[0]}"
    why = "some measurements look like outliers" if fitting == "--robust" else "the noise may be part of the dynamics"
    return [*_without_id_and_folder(words), fitting], why


def _again_with_columns(result: Result, words: Sequence[str]) -> _Proposal | None:
    """Propose an option about missing values; if an equation is not good, also options about other columns."""
    added = {match[1]: match[2] for sentence in reversed(result.warnings) for match in _ADDED.finditer(sentence)}
    is_good = all(equation.verdict in ("exact", "good") for equation in result.equations)
    for option, why in _WHY.items():
        if option in added and not (is_good and option != "missing-value"):
            flag, value = f"--{option}", [*shlex.split(added[option] or "")]
            before = _without_id_and_folder(words)
            return [*(before if option == "missing-value" else _without(before, flag)), flag, *value], why
    return None


def _again_with_larger_budget(result: Result, words: Sequence[str]) -> _Proposal | None:
    """Propose twice the budget if the budget ended the search or the refining, and an equation is not good."""
    ends = {equation.why for equation in result.equations if equation.verdict not in ("exact", "good")}
    budget = result.settings("budget")
    is_cut = bool(ends) and result.refining in ("not refined", "max-time")
    if ("max-time" in ends or is_cut) and budget.get("max_time") is not None:
        seconds = _seconds(words) or cast(float, budget["max_time"])
        again = [*_without(_without_id_and_folder(words), "--max-time"), "--max-time", f"{2.0 * seconds:g}s"]
        return again, _NOT_REFINED if is_cut else _LONGER
    if "max-epochs" in ends and budget.get("max_epochs") is not None and not budget.get("max_epochs_of"):
        epochs = f"{2 * cast(int, budget['max_epochs'])}"
        return [*_without(_without_id_and_folder(words), "--max-epochs"), "--max-epochs", epochs], _LONGER
    return None


def _again_with_operators(result: Result, words: Sequence[str]) -> _Proposal | None:
    """Propose more operators if an equation has no model and the operators were the default ones."""
    has_no_model = any(equation.verdict == "no model" for equation in result.equations)
    if not has_no_model or result.settings("space"):
        return None
    return [
        *_without_id_and_folder(words),
        "--operators",
        _MORE_OPERATORS,
    ], "expressions may need more than the default operators"


def _with_result(result: Result, folder: str) -> _Proposal:
    """Propose a command that uses the equations."""
    kind = result.columns.kind
    if kind == "regression":
        return ["result", f"{folder}/result.json", "--format", "latex"], "the equation for a paper"
    if any(equation.verdict == "no model" for equation in result.equations):
        return ["result", f"{folder}/result.json"], "the best expression of each size"
    is_driven = kind == "process" or result.columns.inputs
    has_initial_state = result.simulated or result.recorded  # a cancelled job may have no initial state
    if is_driven and has_initial_state:
        return ["simulate", folder, "-o", f"{folder}/simulation.csv"], "simulate the model along the measurements"
    if any(not constant.identifiable for equation in result.equations for constant in equation.constants):
        return ["analyse", folder, "--identifiability"], "shows which constants the data determine"
    if result.unmeasured and any(equation.verdict == "doubtful" for equation in result.equations):
        return ["analyse", folder, "--identifiability"], "shows which constants the measured columns determine"
    if any(equation.verdict == "doubtful" and equation.candidates for equation in result.equations):
        return ["suggest", folder], "the experiment that would decide between the candidates"
    return ["analyse", folder], "fixed points, limit cycles and basins of the model"


def _seconds(words: Sequence[str]) -> float | None:
    """Return ``--max-time`` of the command line, in seconds; the result holds only the time left after start-up."""
    given = [after for word, after in pairwise(words) if word == "--max-time"]
    given += [word.partition("=")[2] for word in words if word.startswith("--max-time=")]
    return seconds_of(given[-1]) if given else None


def _without_id_and_folder(words: Sequence[str]) -> list[str]:
    """Return the words without ``--id`` and ``--out``, because this job and folder exist already."""
    return _without(_without(words, "--out"), "--id")


def _without(words: Sequence[str], option: str) -> list[str]:
    """Return the words without an option and its value."""
    kept: list[str] = []
    is_value = False
    for word in words:
        if not is_value and word != option and not word.startswith(f"{option}="):
            kept.append(word)
        is_value = not is_value and word == option
    return kept


_CONNECT_LIMIT_S: Final = 20.0
_WORTH_SAYING_S: Final = 0.05
_REFINING: Final = "refining"


def run_locally(options: argparse.Namespace, folder: Path, endpoint: str, workers: LocalWorkers, started: float) -> int:
    """Start the coordinator, follow the job, write and print its result; return the exit code.

    The caller has started `workers` and ends them; `started` is the start of the command in monotonic seconds. Raises
    UsageError or DataError.
    """
    request = request_of(options)
    with LocalCoordinator(endpoint, workers.number) as coordinator:
        table = request.read()
        coordinator.wait()

        def check_processes() -> list[str]:
            coordinator.check()
            if _REFINING in follower.phases:  # then one worker computes, and a core is free
                request.load_modules_of_result()
            return workers.check()

        with connected(endpoint, _CONNECT_LIMIT_S) as client:
            request.after(time.monotonic() - started).submit(client, table)
            with open_display("") as display:
                follower = Follower(client, request.job, display, check_processes)
                view, forced = _follow(follower, client, display)
            stays = options.web is not None and forced is None and is_screen()
            if not stays:
                workers.dismiss()
            result = request.result(client, view)
            if result is not None:
                try:
                    request.show(result)
                finally:  # also if nobody reads the output, or after Ctrl-C
                    with interrupts_held_back():
                        path = write_result(folder, result)
                note(_times(result, follower.phases, time.monotonic() - started))
                note(f"result in {path}")
                if options.report:
                    write_report(folder / REPORT, result)
                proposed = next_step(result, folder, sys.argv[1:], program_of(Path(sys.argv[0]), Path.cwd()))
                if proposed is not None:
                    note(f"next: {proposed}")
            if stays:
                note("the page stays open until Ctrl-C")
                with contextlib.suppress(KeyboardInterrupt):
                    while True:
                        check_processes()
                        client.pause(1.0)
            return report_exit_code(view) if forced is None else forced


def _follow(follower: Follower, client: Client, display: Display) -> tuple[JobView, int | None]:
    """Follow the job; return its last state, and the exit code if it was ended early.

    An interrupt, or the loss of all workers, cancels the job and keeps its best equations.
    """
    try:
        return follower.follow(), None
    except KeyboardInterrupt:
        display.print_note(KEEPING)
        forced = INTERRUPTED
    except NoWorkerLeftError as error:
        display.print_note(f"coordinator: {error}")
        forced = FAILED
    return client.cancel_and_wait(follower.job), forced


def program_of(path: Path, here: Path) -> str:
    """Return the words that start the program at `path` from the folder `here`: its name, if on PATH, or its path."""
    if path.name != "coordinator" or shutil.which("coordinator") is not None:
        return "coordinator"
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def _times(result: Result, phases: dict[str, float], total: float) -> str:
    """Return the seconds of each phase of a run."""
    parts = {name: phases.get(name, 0.0) for name in ("compiling kernels", "loading kernels")}
    parts["search"] = result.search_seconds or 0.0
    refining = phases.get(_REFINING, 0.0)
    parts[_REFINING] = refining if refining >= _WORTH_SAYING_S else 0.0
    rest = max(0.0, total - sum(parts.values()))
    durations = [f"{name} {duration(seconds)}" for name, seconds in parts.items() if seconds]
    return ", ".join([f"start-up {duration(rest)}", *durations, f"total {duration(total)}"])


def submit(options: argparse.Namespace) -> int:
    """Submit ``options.data`` as a job; return the exit code of the job, unless ``--no-wait``."""
    request = request_of(options)
    if options.dry_run:
        return request.rehearse()
    address = address_of(options)
    folder = Path(options.out) if options.out is not None else None
    if folder is not None and options.no_wait:
        raise UsageError("--out and --no-wait contradict each other: there is no result yet; fetch it later")
    if options.report and (folder is None or options.no_wait):
        raise UsageError(
            "--report writes a page next to the result, so it needs --out and cannot be used with --no-wait"
        )
    if folder is not None:
        refuse_existing_result(folder)
    with raising_interrupts(), connected(address, CONNECT_LIMIT_S) as client:
        look = f"coordinator status {request.job} --connect {address}"
        hint = f"island-worker --connect {address}"
        try:
            view = request.submit(client, request.read())
        except KeyboardInterrupt:
            note(f"interrupted before the coordinator confirmed job {request.job}; to look for it: {look}")
            return INTERRUPTED
        if options.no_wait:
            _print_waiting_reason(view, client, hint)
            say(request.job)
            return DONE
        try:
            with open_display(hint) as display:
                display.print_note(f"job {request.job} submitted; Ctrl-C detaches and leaves it running")
                view = Follower(client, request.job, display).follow()
        except KeyboardInterrupt:
            note(f"detached; the job continues: {look}")
            return INTERRUPTED
        result = request.result(client, view)
        if result is not None:
            _deliver(request, result, folder, has_report=options.report)
        return report_exit_code(view)


def _print_waiting_reason(view: JobView, client: Client, hint: str) -> None:
    """Print why the job waits, for a user who does not follow it."""
    if view.state in FINAL_STATES:
        note(f"job {view.job} already exists and has ended: {view.state}")
    elif waits := waiting(view, Workforce.of(client.workers()), hint):
        note(f"job {view.job} {view.state}; {waits}")


def _deliver(request: JobRequest, result: "Result", folder: Path | None, *, has_report: bool) -> None:
    """Print a result; if a folder is given, write the result and its page into it."""
    try:
        request.show(result)
    finally:
        if folder is not None:
            note(f"result in {write_result(folder, result)}")
    if folder is not None and has_report:
        write_report(folder / REPORT, result)
