"""Tables made of structure and options in every combination, from the upload to the text that a user reads.

``python -m benchmarks.operations.pipelines --cases 10000 --out FILE.jsonl`` draws table, options and what a search may
have found of each seed, prepares, refines within one of `SECONDS`, writes the result and prints it. Each case ends with
a result or is refused with one sentence; nothing broke, nothing took more than `LIMIT_S` of processor time. Most
options of a case fit each other and its table, so that at least three quarters get to their result. A file
that exists is gone on with. ``--seed 123`` plays one case and shows what it is and where it ended. Returns 1 when any
case broke or was late, else 0.
"""

import json
import logging
import os
import signal
import sys
import time
import traceback
from argparse import Namespace
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from atoll.terminal.output import note, say
from atoll.text.render import render_text
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.result.building import KNOWN, Account, VariableOutcome, build_result
from atoll_coordinator.result.result import Result
from atoll_coordinator.tasks.preparing import prepare_job
from atoll_core.errors import DataError, RemoteProtocolError, UsageError
from atoll_core.machine import usable_cores
from benchmarks.harness.campaign import journal_of
from benchmarks.harness.command_line import option, program, whole
from benchmarks.harness.parallel import in_parallel
from benchmarks.operations.drawn_jobs import config_of, pools_of, table_of

SECONDS: Final = (0.1, 0.2, 0.2, 0.5, 2.0)
"""For refining, of processor time, as --max-time leaves them: a stage may be cut short anywhere, and what else a
machine does changes no case much."""

LIMIT_S: Final = 60.0
"""Processor seconds of a whole case: what --max-time ends early has a last stage, and Python starts slowly."""

End = Literal["done", "refused", "broke", "late"]


@dataclass(frozen=True)
class Outcome:
    """How one case ended, with the sentence or the last line of the traceback."""

    seed: int
    end: End
    sentence: str
    processor: float

    @property
    def key(self) -> int:
        """The seed."""
        return self.seed


class LateError(BaseException):
    """Raised in the middle of a case that takes too long; no handler of errors is to catch it."""


def played(seed: int) -> tuple[End, str]:
    """Play one case; return how it ended, and with which sentence."""
    draw = np.random.default_rng(seed)
    table = table_of(draw)
    try:
        config = config_of(draw, table)
    except ValueError as error:  # options that no configuration has
        return "refused", str(error).splitlines()[0]
    try:
        prepared, _ = prepare_job(table.to_bytes(), config)
    except (DataError, UsageError, RemoteProtocolError) as error:
        return ("refused" if "\n" not in str(error) else "broke"), str(error)
    pools = pools_of(draw, prepared)
    deadline = Deadline(float(draw.choice(SECONDS)), time.process_time)
    refinement = refine_all(prepared.preparation, prepared.config, pools, deadline, prepared.laws)
    preparation = prepared.preparation
    outcomes = [
        VariableOutcome(name, pools[name].front, 1, why=KNOWN if name in prepared.known else None)
        for name in preparation.dataset.variables
    ]
    result = build_result("drawn", prepared.config, preparation, outcomes, Account("done", 1.0, 1.0), refinement)
    render_text(Result.load(json.loads(json.dumps(result.as_dict(), allow_nan=False))))
    broken = [warning for warning in result.warnings if "failed (" in warning]
    return ("broke", broken[0]) if broken else ("done", "")


def play(seed: int) -> Outcome:
    """Play one case within its limit, in whichever process; nothing that it raises gets out."""
    began = time.process_time()
    end: End
    try:
        with limited(LIMIT_S), np.errstate(all="ignore"), _unlogged():
            end, sentence = played(seed)
    except LateError:
        end, sentence = "late", _where()
    except Exception as error:
        end, sentence = "broke", f"{type(error).__name__}: {error} {_where()}"
    return Outcome(seed, end, sentence[:300], time.process_time() - began)


def _where() -> str:
    frames = [frame for frame in traceback.extract_tb(sys.exc_info()[2]) if "atoll" in frame.filename]
    return " < ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in reversed(frames[-6:]))


@contextmanager
def _unlogged() -> Iterator[None]:
    """Have nothing logged in the block."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise LateError in the block after so many processor seconds, where the system has a timer for it."""
    if not hasattr(signal, "setitimer"):
        yield
        return

    def ring(*_: object) -> None:
        raise LateError

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def tell(seed: int) -> int:
    """Say what a case is and how it ends; return the exit code."""
    draw = np.random.default_rng(seed)
    table = table_of(draw)
    for name, values in zip(table.names, table.columns, strict=True):
        say(f"{name}: {values.tolist()}")
    say(config_of(draw, table).model_dump_json(exclude_defaults=True))
    outcome = play(seed)
    say(f"{outcome.end} after {outcome.processor:.1f} s: {outcome.sentence}")
    return int(outcome.end in ("broke", "late"))


def _summed(outcomes: Sequence[Outcome]) -> int:
    ends = Counter(outcome.end for outcome in outcomes)
    bad = [outcome for outcome in outcomes if outcome.end in ("broke", "late")]
    seconds = sorted(outcome.processor for outcome in outcomes)
    say(f"{len(outcomes)} cases: {', '.join(f'{count} {end}' for end, count in sorted(ends.items()))}; "
        f"{seconds[len(seconds) // 2]:.2f} s of processor time in the median, {seconds[-1]:.0f} s at most")  # fmt: skip
    for outcome in bad:
        say(f"seed {outcome.seed} {outcome.end}: {outcome.sentence}")
    return int(bool(bad))


@program(
    "benchmarks.operations.pipelines",
    __doc__,
    option("--cases", type=whole, default=1000, help="how many (%(default)s)"),
    option("--first", type=int, default=0, help="the first seed (%(default)s)"),
    option("--processes", type=whole, default=usable_cores(os.environ)[0], help="at a time (%(default)s)"),
    option("--out", type=Path, metavar="FILE", help="file of JSON lines, gone on with if it exists"),
    option("--seed", type=int, help="play this one and show it"),
)
def main(options: Namespace) -> int:
    """Play the cases that the file does not have, and sum up."""
    if options.seed is not None:
        return tell(options.seed)
    journal = journal_of("pipelines", Outcome, options)
    seeds = range(options.first, options.first + options.cases)
    missing = [seed for seed in seeds if seed not in journal.outcomes]
    for count, outcome in enumerate(in_parallel(play, missing, options.processes), start=1):
        journal.add(outcome)
        if outcome.end in ("broke", "late"):
            note(f"seed {outcome.seed} {outcome.end}: {outcome.sentence}")
        if count % 100 == 0:
            note(f"{count} of {len(missing)}")
    return _summed([journal.outcomes[seed] for seed in seeds])


if __name__ == "__main__":
    sys.exit(main())
