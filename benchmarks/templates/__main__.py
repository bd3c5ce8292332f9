"""A known part, an unknown rest, and states that no column measures.

``python -m benchmarks.templates glycolysis --out FILE`` draws the cells of the published benchmark (points by noise,
five draws each) and prints the table; ``information`` says what these rows can tell of the frequency at best, see
`benchmarks.templates.information`; ``systems`` searches the systems of `benchmarks.templates.systems`, clean and
with 1 % of noise; ``one-column``, ``tanks`` and ``emps`` forecast with a hidden state, see
`benchmarks.templates.forecasts`; ``tank-physics`` fits the tanks by their physics, without a search. A file that exists
is gone on with.
"""

import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from atoll.terminal.output import say
from benchmarks.harness.campaign import Answer, Service, attempt, journal_of, judge_again, work_off
from benchmarks.harness.command_line import option, program, seeds_of, whole, workers
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.templates import forecasts, glycolysis, hidden
from benchmarks.templates.forecasts import ForecastKey, ForecastOutcome
from benchmarks.templates.glycolysis import NOISE, POINTS, GlycolysisKey, GlycolysisOutcome
from benchmarks.templates.hidden import SystemKey, SystemOutcome
from benchmarks.templates.information import table_of_information
from benchmarks.templates.systems import SYSTEMS
from benchmarks.templates.tank_physics import table_of_physics

KINDS: Final = ("glycolysis", "information", "systems", "one-column", "tanks", "tank-physics", "emps")


_SYSTEMS: Final[Mapping[str, Sequence[str]]] = {
    "one-column": tuple(forecasts.ONE_COLUMN),
    "tanks": forecasts.TANK_WAYS,
    "emps": forecasts.EMPS_WAYS,
}
"""Forecasts by kind."""


def _glycolysis(options: Namespace) -> None:
    wanted = [
        GlycolysisKey(points, noise, seed)
        for points in options.points
        for noise in options.noise
        for seed in options.seeds
    ]

    def do(service: Service, key: GlycolysisKey) -> tuple[GlycolysisOutcome, Answer]:
        table, config = glycolysis.request_of(key)
        ended = attempt(service(), key.title, table, config, Stopwatch())
        return glycolysis.judge(key, ended.result, ended.seconds, ended.failure), ended.result or None

    journal = journal_of("templates", GlycolysisOutcome, options)
    if options.judge_again:
        judge_again(wanted, journal, lambda key, old, answer: glycolysis.judge(key, answer, old.seconds, old.failure))
    outcomes = work_off(wanted, journal, do, glycolysis.line, options.workers)
    say(glycolysis.table_of(outcomes))


def _systems(options: Namespace) -> None:
    wanted = [
        SystemKey(name, noise, seed)
        for name in options.systems or SYSTEMS
        for noise in (0, 1)
        for seed in options.seeds
    ]

    def do(service: Service, key: SystemKey) -> tuple[SystemOutcome, Answer]:
        table, config = hidden.request_of(key)
        ended = attempt(service(), key.title, table, config, Stopwatch())
        return hidden.judge(key, ended.result, ended.seconds, ended.failure), ended.result or None

    journal = journal_of("templates", SystemOutcome, options)
    outcomes = work_off(wanted, journal, do, hidden.line, options.workers)
    say(hidden.table_of(outcomes))


def _forecasts(options: Namespace) -> None:
    systems = [one for one in _SYSTEMS[options.kind] if one in (options.cases or _SYSTEMS[options.kind])]
    wanted = [
        ForecastKey(system, noise, seed)
        for system in systems
        for noise in ((0, 1) if options.kind == "one-column" else (0,))
        for seed in options.seeds
    ]

    def do(service: Service, key: ForecastKey) -> tuple[ForecastOutcome, Answer]:
        case = forecasts.case_of(key, options.data)
        table, config = forecasts.request_of(key, case)
        ended = attempt(service(), key.title, table, config, Stopwatch())
        return forecasts.judge(key, case, ended.result, ended.seconds, ended.failure), ended.result or None

    journal = journal_of("templates", ForecastOutcome, options)
    outcomes = work_off(wanted, journal, do, forecasts.line, options.workers)
    say(forecasts.table_of(outcomes))


@program(
    "benchmarks.templates",
    __doc__,
    option("kind", choices=KINDS, help="what is searched"),
    option("--points", type=whole, nargs="+", default=list(POINTS), help="of glycolysis; default: all"),
    option("--noise", type=whole, nargs="+", default=list(NOISE), help="of glycolysis, in per cent; default: all"),
    option("--systems", choices=tuple(SYSTEMS), nargs="+", help="default: all"),
    option("--cases", nargs="+", metavar="NAME", help="some of the jobs of one-column, tanks or emps; default: all"),
    option("--data", type=Path, metavar="DIR", help="folder of cascaded_tanks_train.csv, emps_train.csv"),
    seeds_of("1-5", "draws, such as 1-5 (1-5)"),
    workers(),
    option("--judge-again", action="store_true", help="judge what the file holds of glycolysis by the present rules"),
    option("--out", "--resume", type=Path, metavar="FILE", help="file of JSON lines, gone on with if it exists"),
)
def main(options: Namespace) -> int:
    """Do what the options ask for."""
    if options.kind == "glycolysis":
        _glycolysis(options)
    elif options.kind == "information":
        say(table_of_information(options.points, options.noise))
    elif options.kind == "tank-physics":
        say(table_of_physics(forecasts.case_of(ForecastKey(forecasts.BY_NUMBER, 0, 0), options.data)))
    elif options.kind in _SYSTEMS:
        _forecasts(options)
    else:
        _systems(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
