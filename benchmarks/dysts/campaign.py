"""All searches that are asked for, one after another, and the tables of what came of them."""

import argparse
import time
from collections.abc import Sequence

from atoll.config import PRESETS, JobConfig
from atoll.errors import AtollError
from atoll_coordinator.cli.terminal.output import note, say
from benchmarks.dysts.flows import NEVER_POLYNOMIAL, Flow, available, load
from benchmarks.dysts.judging import Outcome, outcome
from benchmarks.dysts.making import POLYNOMIAL
from benchmarks.dysts.tables import by_system, line, summary
from benchmarks.harness.command_line import plain_errors
from benchmarks.harness.journal import Journal, read
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.stopwatch import Stopwatch


def run(options: argparse.Namespace, arguments: Sequence[str]) -> int:
    """Search what the journal does not have, print the tables."""
    with plain_errors("benchmarks.dysts"):
        names = options.systems or available(options.data)
        journal = Journal("dysts", Outcome, options.resume or options.out, arguments, resume=options.resume is not None)
        wanted = [(name, noise) for noise in options.noise for name in names]
        missing = [key for key in wanted if key not in journal.outcomes]
        note(f"{len(wanted)} searches, {len(wanted) - len(missing)} of them done before")
        if missing:
            with searching(options.workers) as searches:
                for name, noise in missing:
                    journal.add(_one(searches, load(options.data, name), noise, options))
                    note(line(journal.outcomes[name, noise]))
        _print([journal.outcomes[key] for key in wanted], options)
    return 0


def show(options: argparse.Namespace) -> int:
    """Print the tables of a file."""
    with plain_errors("benchmarks.dysts"):
        found = read(options.resume, Outcome).values()
        _print([each for each in found if not options.systems or each.system in options.systems], options)
    return 0


def _print(outcomes: Sequence[Outcome], options: argparse.Namespace) -> None:
    say(by_system(outcomes, options.published))
    say("\n" + summary(outcomes, options.published))


def _one(searches: Searches, flow: Flow, noise: float, options: argparse.Namespace) -> Outcome:
    stopwatch, begun = Stopwatch(), time.monotonic()
    try:
        result = searches.solve(
            f"{flow.name} {noise:g} %", flow.table(noise, options.seed), _configured(flow, options), stopwatch.watch
        )
    except AtollError as error:
        searches.check()  # without a coordinator no job is to blame
        nothing = (None,) * len(flow.states)
        in_form = (False,) * len(flow.states)
        seconds = time.monotonic() - begun
        return Outcome(flow.name, noise, None, in_form, None, nothing, nothing, seconds, stopwatch.seconds, str(error))
    return outcome(flow, noise, result, stopwatch.seconds)


def _configured(flow: Flow, options: argparse.Namespace) -> JobConfig:
    """Return the default configuration; more operators for flows that are not polynomial."""
    config = PRESETS["default"]
    budget = config.budget.model_copy(update={"max_time": options.max_time})
    space = config.space
    if flow.name not in POLYNOMIAL:
        space = space.model_copy(update={"operators": NEVER_POLYNOMIAL})
    return config.model_copy(update={"seed": options.seed, "budget": budget, "space": space})
