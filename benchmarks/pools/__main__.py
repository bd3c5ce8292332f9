"""About a hundred stored pools refined again, next to the reference: ``python -m benchmarks.pools judge``, `make
judge`.

Each pool of ``pools/`` is refined (its table is prepared, the equations are chosen, fitted and judged, without a
search), and forms, grades and processor seconds are printed next to the values of ``reference.json``, with each
equation that changed and the probability of as large a difference by chance. ``--accept`` writes a new reference.
``beside --source DIR`` refines pools by this tree and by another tree in turn: processor seconds, and equal results.
Tables of listed cases and of real measurements are read from folders (``--cases``, ``--real``); pools without their
table are named and not judged. ``keep`` searches the missing pools: one for each line of ``titles.txt``. Exit code 1:
fewer right equations or more false grades than chance allows (p below 0.05), or a pool failed.
"""

import os
import sys
from argparse import Namespace
from functools import partial
from pathlib import Path
from typing import Final

from atoll.terminal.output import note, say, table
from atoll_coordinator.settings import Settings
from atoll_core.errors import UsageError
from benchmarks.harness.command_line import option, positive, program, verb, verbs, whole, workers
from benchmarks.harness.parallel import in_parallel
from benchmarks.pools.beside import compare_all, refine_and_digest
from benchmarks.pools.beside import report as report_beside
from benchmarks.pools.campaign import (
    POOLS,
    REFERENCE,
    changes_of,
    has_table,
    judge_pool,
    requests,
    sample,
    titles,
    with_settings,
)
from benchmarks.pools.cases import LISTED_VARIABLE, REAL_VARIABLE, Folders
from benchmarks.pools.outcomes import effect, read_reference, report, seconds_of, write_reference
from benchmarks.pools.stored import keep_pools


def _folder(variable: str) -> Path | None:
    return Path(os.environ[variable]) if os.environ.get(variable) else None


FOLDERS: Final = (
    option("--cases", type=Path, default=_folder(LISTED_VARIABLE), metavar="DIR", help="tables with cases.json"),
    option("--real", type=Path, default=_folder(REAL_VARIABLE), metavar="DIR", help="real measurements"),
    option("--only", nargs="+", default=[], metavar="WORD", help="parts of titles; default: all"),
)


@program(
    "benchmarks.pools",
    __doc__,
    verbs(
        verb(
            "judge", "refine stored pools and compare", *FOLDERS, workers(),
            option("--accept", action="store_true", help="write the outcomes as the new reference"),
        ),
        verb(
            "settings", "halve and double each setting, and count the changes", workers(),
            option("--stages", nargs="+", default=[], metavar="STAGE", help="such as selection; default: all"),
            option("--only", nargs="+", default=[], metavar="WORD", help="drawn pools, by parts of their titles"),
            option("--pools", type=whole, default=12, help="else the quickest drawn pools of each kind (%(default)d)"),
            option("--out", type=Path, metavar="FILE", help="file of lines, gone on with if it exists"),
        ),
        verb(
            "beside", "processor seconds and digests next to another tree, pool by pool", *FOLDERS,
            option("--source", type=Path, required=True, metavar="DIR", help="root of the other tree"),
        ),
        verb("digest", None, *FOLDERS[:2], option("title")),
        verb(
            "keep", "search the pools that are missing", *FOLDERS, workers(),
            option("--max-time", type=positive, default=20.0, help="end of a search in seconds (%(default)g)"),
        ),
    ),
)  # fmt: skip
def main(options: Namespace) -> int:
    """Run the command of the options."""
    if options.verb == "settings":
        return _try_settings(options)
    folders = Folders(options.cases, options.real)
    if options.verb == "digest":
        say(refine_and_digest(options.title, folders))
        return 0
    wanted = [title for title in titles() if not options.only or any(word in title for word in options.only)]
    for title in wanted:
        if not has_table(title, folders):
            note(f"not judged: {title}: its table is read from a folder that was not named (--cases, --real)")
    wanted = [title for title in wanted if has_table(title, folders)]
    if options.verb == "keep":
        keep_pools(requests(wanted, folders, options.max_time), POOLS, options.workers)
        return 0
    if options.verb == "beside":
        pairs = compare_all(wanted, folders, options.source)
        say(report_beside(pairs))
        return 0 if all(pair.is_equal for pair in pairs) else 1
    outcomes, reference = {}, read_reference(REFERENCE)
    longest_first = sorted(wanted, key=lambda title: -seconds_of(reference.get(title)))
    for outcome in in_parallel(partial(judge_pool, folders=folders), longest_first, options.workers):
        outcomes[outcome.title] = outcome
        note(f"{len(outcomes)} of {len(wanted)}: {outcome.line}")
    judged = [outcomes[title] for title in wanted]
    text, is_as_good = report(judged, reference)
    say(text)
    if options.accept:
        write_reference(REFERENCE, judged)
    return 0 if is_as_good else 1


def _try_settings(options: Namespace) -> int:
    reference = read_reference(REFERENCE)
    drawn = [title for title in titles() if has_table(title, Folders())]
    wanted = [title for title in drawn if any(word in title for word in options.only)]
    if options.only and not wanted:
        raise UsageError(f"--only: no drawn pool has a title with {' or '.join(options.only)}")
    wanted = wanted or sample(reference, options.pools, 5.0)
    before = with_settings("", wanted, options.workers)
    baseline = {one.title: one for one in before}
    heads = ("setting", "right, gained", "lost", "grades changed", "newly false", "failed", "seconds, ratio")
    done = options.out.read_text("utf-8").splitlines() if options.out and options.out.exists() else []
    rows = {line.split("\t")[0]: tuple(line.split("\t")) for line in done}
    for change in changes_of(Settings()):
        if change.text in rows or (options.stages and change.name.partition(".")[0] not in options.stages):
            continue
        rows[change.text] = (change.text, *effect(with_settings(change.text, wanted, options.workers), baseline))
        note(", ".join(rows[change.text]))
        if options.out:
            with options.out.open("a", encoding="utf-8") as stream:
                stream.write("\t".join(rows[change.text]) + "\n")
    say(table(heads, list(rows.values())))
    return 0


if __name__ == "__main__":
    sys.exit(main())
