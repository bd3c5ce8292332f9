"""``python -m benchmarks.dask_trial``: all measures, one after the other; needs ``pip install -e '.[bench]'``."""

import logging
import sys
from argparse import Namespace
from collections.abc import Callable
from functools import partial

from atoll.terminal.output import note, say
from benchmarks.dask_trial import measures
from benchmarks.dask_trial.cluster import check_installed
from benchmarks.harness.command_line import OUT, option, program
from benchmarks.harness.record import Record, load

ONLY = {measure.__name__: measure for measure in measures.measured_alone()}
COMPARED = {measure.__name__: measure for measure in (measures.work, measures.lost_worker)}


@program(
    "benchmarks.dask_trial",
    "Measure dask.distributed as what carries Atoll's tasks.",
    option("--parts", nargs="+", choices=[*ONLY, *COMPARED], help="what is measured (all)"),
    OUT,
)
def main(options: Namespace) -> None:
    """Measure and print a sentence for each figure."""
    check_installed()
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    parts = options.parts or [*ONLY, *COMPARED]
    record, figures = Record("dask_trial", options.words, options.out), {}
    digest = ""
    if set(parts) & set(COMPARED):
        digest, sentence = measures.alone()
        figures["alone"] = [sentence]
        say(sentence)
    measuring: dict[str, Callable[[], list[str]]] = {
        **ONLY,
        **{name: partial(measure, digest) for name, measure in COMPARED.items()},
    }
    for name in parts:
        note(f"{name}, load {load():.1f}")
        figures[name] = measuring[name]()
        for sentence in figures[name]:
            say(sentence)
        record.write(figures=figures)


if __name__ == "__main__":
    sys.exit(main())
