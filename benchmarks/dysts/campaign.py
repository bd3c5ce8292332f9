"""All searches that are asked for, one after another, and the tables of what came of them."""

from argparse import Namespace

from atoll.terminal.output import say
from benchmarks.dysts.flows import NEVER_POLYNOMIAL, available, load
from benchmarks.dysts.judging import Outcome, outcome
from benchmarks.dysts.making import POLYNOMIAL
from benchmarks.dysts.tables import by_system, line, summary
from benchmarks.harness.campaign import Service, attempt, journal_of, work_off
from benchmarks.harness.command_line import plain_errors
from benchmarks.harness.jobs import configured
from benchmarks.harness.journal import read
from benchmarks.harness.stopwatch import Stopwatch


def run(options: Namespace) -> int:
    """Search what the journal does not have, or read the file that is to be shown; print the tables."""
    with plain_errors("benchmarks.dysts"):
        if options.verb == "show":
            shown = read(options.resume, Outcome).values()
            outcomes = [outcome for outcome in shown if not options.systems or outcome.system in options.systems]
        else:
            outcomes = _searched(options)
        say(by_system(outcomes, options.published))
        say("\n" + summary(outcomes, options.published))
    return 0


def _searched(options: Namespace) -> list[Outcome]:
    names = options.systems or available(options.data)

    def do(service: Service, key: tuple[str, float]) -> tuple[Outcome, None]:
        flow, stopwatch = load(options.data, key[0]), Stopwatch()
        operators = None if flow.name in POLYNOMIAL else NEVER_POLYNOMIAL
        config = configured(options.seed, {}, {"max_time": options.max_time}, operators)
        table = flow.table(key[1], options.seed)
        job = attempt(service(), f"{flow.name} {key[1]:g} %", table, config, stopwatch)
        if job.failure is None:
            return outcome(flow, key[1], job.result, stopwatch.seconds), None
        none, no = (None,) * len(flow.states), (False,) * len(flow.states)
        return Outcome(*key, None, no, None, none, none, job.seconds, stopwatch.seconds, job.failure), None

    wanted = [(name, noise) for noise in options.noise for name in names]
    return work_off(wanted, journal_of("dysts", Outcome, options), do, line, options.workers)
