"""Progress on stderr: a table that is redrawn on a terminal, otherwise a few plain lines every few seconds.

The texts are pure functions of the coordinator's views of a job and its workers. The displays only decide when and how
the texts appear.
"""

import json
import os
import re
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, Self

from atoll.client.follower import Display
from atoll.terminal.output import clip, count, duration, error_text, note, shorten
from atoll_core.compilation.progress import share_of
from atoll_core.quoting import visible, visible_line
from atoll_core.wire.messages.views import FINAL_STATES, JobView, VariableView, Workforce

if TYPE_CHECKING:
    from rich.console import Group

PLAIN_INTERVAL_S: Final = 5.0
_PASSING: Final = re.compile(r"\b[0-9]+ (s( of [0-9]+ s left)?\b|of [0-9]+ compiled)")
"""Numbers of seconds and of compiled kernels: they change every second, without a change of the state."""
_HEADS: Final = ("equation", "epoch", "error", "size", "best so far", "")


def open_display(connect_hint: str) -> Display:
    """Return the display for stderr. `connect_hint` is the command that starts a worker, "" if none is needed."""
    return LiveDisplay(connect_hint) if is_screen() else PlainDisplay(connect_hint)


def is_screen() -> bool:
    """Tell whether stderr is a terminal on which a table can be redrawn."""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


def headline(view: JobView, workforce: Workforce, connect_hint: str) -> str:
    """Return one line about the whole job: state, elapsed time, workers, speed, and why it waits."""
    number = view.workers or workforce.alive
    parts = [f"job {view.job} {view.state}", duration(view.elapsed), "1 worker" if number == 1 else f"{number} workers"]
    if view.point_evaluations:
        parts.append(f"{count(view.point_evaluations)} point evaluations")
    if view.point_evaluations_per_second and view.state not in FINAL_STATES:
        parts.append(f"{count(view.point_evaluations_per_second)}/s")
    compared = sum(task.compared for task in view.tasks)
    if compared:
        parts.append(f"{compared:,} candidates compared")
    waits = waiting(view, workforce, connect_hint)
    return ", ".join(parts) + (f"; {waits}" if waits else "")


def waiting(view: JobView, workforce: Workforce, connect_hint: str) -> str:
    """Return why an unfinished job waits or makes no progress; "" if it makes progress."""
    if view.state in FINAL_STATES:
        return ""
    if not workforce.alive:
        return f"no worker has joined; start one with: {connect_hint}" if connect_hint else "its workers are starting"
    if workforce.compiling == workforce.alive:
        return f"workers are starting: {workforce.details[0] if workforce.details else 'loading kernels'}"
    return view.reason or (view.stalls[0] if view.stalls else "")


def row(variable: VariableView) -> tuple[str, ...]:
    """Return the cells of one equation, in the order of the table's heads."""
    size = "-" if variable.complexity is None else str(variable.complexity)
    best = shorten(variable.expression) if variable.expression else "-"
    return (variable.lhs, str(variable.epoch), error_text(variable.normalized_error), size, best, standing(variable))


def standing(variable: VariableView) -> str:
    """Return the state of the search of one equation, or its verdict after the search."""
    if variable.why == "known":
        return "known"
    if variable.verdict:
        return variable.verdict
    if variable.converged:
        return "converged"
    if not variable.finished:
        return "searching" if variable.epoch else ""
    return f"ended: {variable.why}" if variable.why else "ended"


def plain_lines(view: JobView, workforce: Workforce, connect_hint: str) -> list[str]:
    """Return the lines of the plain display: the headline, then a line for each equation whose search has begun."""
    lines = [headline(view, workforce, connect_hint)]
    for variable in view.variables:
        if not variable.epoch and not variable.finished:
            continue
        lhs, epoch, error, size, best, stand = row(variable)
        ending = f"  ({stand})" if stand else ""
        lines.append(f"  {lhs}  epoch {epoch}  error {error}  size {size}  {clip(best, 90)}{ending}")
    return lines


class PlainDisplay(Display):
    """Writes plain lines when the state of the job or of an equation changes, and every few seconds."""

    def __init__(self, connect_hint: str, write: Callable[[str], None] = note) -> None:
        self._hint = connect_hint
        self._write = write
        self._shown: tuple[object, ...] = ()
        self._due = 0.0

    def show(self, view: JobView, workforce: Workforce, now: float) -> None:
        """Write the lines if the state has changed or the interval has passed."""
        standings = tuple((variable.finished, variable.converged) for variable in view.variables)
        state = (view.state, standings, _PASSING.sub("", waiting(view, workforce, self._hint)))
        if state == self._shown and now < self._due:
            return
        self._shown, self._due = state, now + PLAIN_INTERVAL_S
        for line in plain_lines(view, workforce, self._hint):
            self._write(line)

    def print_note(self, sentence: str) -> None:
        """Write the sentence."""
        self._write(sentence)


class JsonDisplay(Display):
    """Writes one JSON object per line for every change of the view; sentences go to stderr."""

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self._shown: JobView | None = None

    def show(self, view: JobView, workforce: Workforce, now: float) -> None:
        """Write the view, unless only the elapsed time has changed."""
        del workforce, now
        timeless = view.model_copy(update={"elapsed": 0.0, "point_evaluations_per_second": None})
        if timeless != self._shown:
            self._shown = timeless
            self._write(json.dumps(view.model_dump(mode="json"), ensure_ascii=False))

    def print_note(self, sentence: str) -> None:
        """Write the sentence on stderr."""
        note(sentence)


class LiveDisplay(Display):
    """A table that is redrawn in place on a terminal; its last state remains."""

    def __init__(self, connect_hint: str) -> None:
        from rich.console import Console
        from rich.live import Live

        self._hint = connect_hint
        self._live = Live(console=Console(stderr=True), auto_refresh=False)

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def show(self, view: JobView, workforce: Workforce, now: float) -> None:
        """Redraw the table."""
        self._live.update(self._table(view, workforce), refresh=True)

    def print_note(self, sentence: str) -> None:
        """Print the sentence above the table."""
        self._live.console.print(visible(sentence), markup=False, highlight=False)

    def _table(self, view: JobView, workforce: Workforce) -> "Group":
        from rich import box
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        grid = Table(box=box.SIMPLE_HEAD, pad_edge=False)
        for head in _HEADS:
            grid.add_column(head, justify="right" if head in ("epoch", "size") else "left", overflow="fold")
        for variable in view.variables:
            is_found = variable.verdict in ("exact", "good") if variable.verdict else variable.converged
            grid.add_row(*(Text(visible_line(cell)) for cell in row(variable)), style="green" if is_found else "")
        shares = [share_of(detail) for detail in workforce.details]
        bars = [ProgressBar(total=1.0, completed=share, width=40) for share in shares if share is not None]
        return Group(Text(visible(headline(view, workforce, self._hint))), *bars, *([grid] if view.variables else []))
