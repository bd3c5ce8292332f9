"""Every figure that README and documentation quote, measured again by one command, and put where they quote it.

``python -m benchmarks.figures measure --strogatz DIR --dysts DIR`` runs the benchmarks of `PLAN` one after another,
about a hundred minutes on two cores of its own, and writes each figure into ``benchmarks/figures.json`` as soon as it
is known: with the command, the revision, the date, the machine and its load. What this revision has already measured is
not measured again, so that a run that was interrupted goes on. ``--quick`` takes fewer seeds, ``--minutes 35`` bounds
all of it: each benchmark gets its share, and what has ended by then counts. ``show`` prints the figures; ``quote``
writes them into README and ``docs``, where ``<!-- figure: NAME -->TEXT<!-- end -->`` stands. A test fails where a text
is not the figure of the file.
"""

import argparse
import importlib.util
import json
import math
import os
import re
import signal
import statistics
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from atoll.terminal.output import note, say, table
from atoll_core import ENGINE_REVISION
from atoll_core.errors import DataError
from benchmarks.corpus.cases import LEAST_T
from benchmarks.harness.command_line import option, positive, program, seeds, verb, verbs
from benchmarks.harness.record import head
from benchmarks.judging.generalisation import GOOD_R2

ROOT: Final = Path(__file__).resolve().parents[1]
FILE: Final = ROOT / "benchmarks/figures.json"
FOLDER: Final = ROOT / "build/figures"
CODE: Final = ("common", "coordinator", "island_worker")
"""What a figure depends on; a working tree that differs here from its revision is marked by a plus sign."""

MARK: Final = re.compile(r"<!-- figure: (?P<name>[\w.-]+) -->(?P<text>.*?)<!-- end -->")

Runs = Sequence[Mapping[str, Any]]
Figures = dict[str, dict[str, Any]]
NONE: Final = "0 of 0"
"""Says nothing, and takes no other figure's place."""

_STOP_S: Final = 60.0


@dataclass(frozen=True)
class Measurement:
    """One benchmark: its command without seeds and file, and how figures follow from its runs.

    `seeds` are those of the figures that are quoted, `few` those of ``--quick`` (empty: it is left out there), each of
    `per_seed` runs; `minutes` are about what the whole and the few take on two cores of their own, and the share of
    ``--minutes`` that it gets.
    `needs` names folders and packages; `resumes` the option by which a file of JSON lines is gone on with.
    """

    name: str
    command: str
    seeds: str
    few: str
    per_seed: int
    minutes: tuple[float, float]
    figures: Callable[[Runs], dict[str, str]]
    needs: tuple[str, ...] = ()
    resumes: str | None = None


def _count(part: Sequence[bool]) -> str:
    return f"{sum(part)} of {len(part)}"


def _seconds(value: float) -> str:
    return f"{value:.3f} s" if 0.0095 <= value < 0.095 else f"{value:.2g} s"


def _table3(runs: Runs) -> dict[str, str]:
    took = sorted(run["search_seconds"] for run in runs if run["exact"])
    figures = {"found": _count([run["exact"] for run in runs])}
    return figures | ({"seconds": f"{took[0]:.2g} to {took[-1]:.2g} s"} if took else {})


def _race(runs: Runs) -> dict[str, str]:
    ours, peers = (
        statistics.geometric_mean(12.0 if run[who] is None else max(run[who], 1e-3) for run in runs)
        for who in ("ours", "peers")
    )
    return {
        "met": _count([run["ours"] is not None for run in runs]),
        "seconds": _seconds(ours),
        "operon": _count([run["peers"] is not None for run in runs]),
        "ratio": f"{ours / peers:.2g}",
    }


def _labels(runs: Runs) -> dict[str, str]:
    return {"right": _count([run["srbench"] for run in runs]), "strict": _count([run["strict"] for run in runs])}


def _equations(runs: Runs) -> Iterator[Mapping[str, Any]]:
    return (equation for run in runs for equation in run["equations"])


def _identifiable(runs: Runs) -> dict[str, str]:
    able = [equation for equation in _equations(runs) if equation["t"] is None or equation["t"] >= LEAST_T]
    return {"right": _count([equation["form"] == "right" for equation in able])}


def _verdicts(runs: Runs) -> dict[str, str]:
    shown = [equation for equation in _equations(runs) if equation["grade"]]
    good = [
        equation["r2"] > GOOD_R2 for equation in shown if equation["grade"] == "good" and equation["r2"] is not None
    ]
    exact = [equation["form"] == "right" for equation in shown if equation["grade"] == "exact"]
    return {"good": _count(good), "exact": _count(exact), **_identifiable(runs)}


def _flows(runs: Runs) -> dict[str, str]:
    return {"right": _count([run["error"] is not None and run["error"] < 0.01 for run in runs])}


def _systems(runs: Runs) -> dict[str, str]:
    return {"right": _count([form == "right" for run in runs for form in run["forms"]])}


PLAN: Final = (
    Measurement(
        "table3", "benchmarks.paper.table3 --derivatives given --max-time 60", "0-4", "0", 14, (2.0, 1.0), _table3,
    ),
    Measurement(
        "labels", "benchmarks.peers.strogatz --data {strogatz} --noise 0 --max-time 30", "0-9", "0-1", 14, (3.0, 1.0),
        _labels, ("strogatz",),
    ),
    Measurement(
        "noisy-labels", "benchmarks.peers.strogatz --data {strogatz} --noise 0.01 --max-time 30", "20-21", "20", 14,
        (10.0, 5.0), _labels, ("strogatz",),
    ),
    Measurement(
        "race", "benchmarks.peers.strogatz --data {strogatz} --versus operon --max-time 12", "0-9", "0-1", 14,
        (10.0, 4.0), _race, ("strogatz", "pyoperon"),
    ),
    Measurement(
        "beside",
        "benchmarks.corpus --in-turn --states 1 2 --trajectories 4 --workers 1 --qualities exact rk45-1e-6 noise-0.001 "
        "noise-0.01 noise-0.05 ar1-0.01 proportional-0.01",
        "1000-1007", "1000-1007", 2, (8.0, 8.0), _identifiable, resumes="--out",
    ),
    Measurement(
        "yeast", "benchmarks.many run --systems yeast --noise 0 --max-time 600", "1000-1002", "1000", 1, (9.0, 3.0),
        _systems, resumes="--resume",
    ),
    Measurement(
        "verdicts", "benchmarks.corpus --in-turn --states 1 2 --trajectories 1 4 --max-time 240", "1600-1628",
        "1600-1603", 4, (45.0, 7.0), _verdicts, resumes="--out",
    ),
    Measurement(
        "flows", "benchmarks.dysts run --polynomial --data {dysts} --noise 1 --seed 2000 --max-time 60", "", "", 70,
        (20.0, 20.0), _flows, ("dysts",), resumes="--resume",
    ),
)  # fmt: skip
"""In the order of what they tell for the time they take."""


def runs_of(path: Path) -> Runs:
    """Return the runs that a benchmark has written, of a file of JSON lines or of JSON; none where there is no file."""
    if not path.exists():
        return []
    text = path.read_text("utf-8")
    if path.suffix == ".jsonl":
        whole, _, _ = text.rpartition("\n")
        lines = map(json.loads, whole.splitlines())
        return [line["outcome"] for line in lines if "outcome" in line]
    contents = json.loads(text)
    runs: Runs = contents.get("runs") or []
    return runs


def missing(measurement: Measurement, folders: Mapping[str, Path | None]) -> str | None:
    """Return what a benchmark needs and is not there, None if nothing."""
    for need in measurement.needs:
        if need in folders:
            if folders[need] is None:
                return f"--{need} DIR was not given"
        elif importlib.util.find_spec(need) is None:
            return f"the package {need} is not installed"
    return None


def command(measurement: Measurement, chosen: str, out: Path, folders: Mapping[str, Path | None]) -> list[str]:
    """Return the command of one benchmark with the seeds `chosen`, its figures to `out`."""
    asked = measurement.command.format_map({name: str(path) for name, path in folders.items()})
    option = measurement.resumes if measurement.resumes and out.exists() else "--out"
    return [sys.executable, "-m", *asked.split(), *(["--seeds", chosen] if chosen else []), option, str(out)]


def run(words: Sequence[str], limit_s: float | None) -> None:
    """Run a command to its end, in so many seconds; an interrupt ends it, too."""
    process = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.DEVNULL, start_new_session=True)
    try:
        process.wait(limit_s)
    except subprocess.TimeoutExpired:
        note("the time is up")
    finally:
        _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    for way in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        if process.poll() is None:
            os.kill(process.pid, way)
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                continue


def revision() -> str:
    """Return the short name of this revision, with a plus sign where the code differs from it."""
    named = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    differs = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", *CODE], cwd=ROOT, capture_output=True)
    return (named.stdout.strip() or "unknown") + ("+" if differs.returncode else "")


def load_figures(path: Path = FILE) -> Figures:
    """Return the figures of the file by name; raises DataError."""
    try:
        figures: Figures = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read ({error}); measure or check it out again") from error
    return figures


@dataclass(frozen=True, eq=False)
class Campaign:
    """What all measurements of one call have in common: folders of data, the revision, and the file of figures."""

    folders: Mapping[str, Path | None]
    revision: str
    file: Path
    known: Figures

    def measure(self, measurement: Measurement, chosen: str, limit_s: float | None) -> list[str]:
        """Run one benchmark and write its figures to the file; return a line where it did not come to its end."""
        out = FOLDER / f"{measurement.name}-{chosen}-{self.revision}.json{'l' if measurement.resumes else ''}"
        out.parent.mkdir(parents=True, exist_ok=True)
        words = command(measurement, chosen, out, self.folders)
        bound = "" if limit_s is None else f", {limit_s / 60.0:.1f} minutes at most"
        note(f"{measurement.name}: {' '.join(words[2:])}{bound}")
        about = head(measurement.name, words[2:])
        run(words, limit_s)
        runs = runs_of(out)
        is_complete = len(runs) == measurement.per_seed * (len(seeds(chosen)) if chosen else 1)
        for name, figure in measurement.figures(runs).items() if runs else ():
            if figure == NONE:
                continue
            self.known[f"{measurement.name}.{name}"] = {
                "figure": figure,
                "runs": len(runs),
                "seeds": chosen,
                "complete": is_complete,
                "revision": self.revision,
                "engine": ENGINE_REVISION,
                "date": about["date"],
                "processor": about["machine"]["processor"],
                "cores": about["machine"]["cores"],
                "load": round(about["load_before"], 1),
                "command": f"python -m {measurement.command}",
            }
        self.file.write_text(json.dumps(self.known, indent=1, ensure_ascii=False, sort_keys=True) + "\n", "utf-8")
        return [] if is_complete else [f"{measurement.name}: ended after {len(runs)} runs"]

    def has(self, measurement: Measurement, chosen: str) -> bool:
        """Return whether the file holds figures of this measurement by this revision and these seeds, to their end."""
        known = [figure for name, figure in self.known.items() if name.startswith(f"{measurement.name}.")]
        measured = {(figure["revision"], figure["seeds"], figure["complete"]) for figure in known}
        return not self.revision.endswith("+") and measured == {(self.revision, chosen, True)}


def measure(options: Namespace) -> int:
    """Run the plan; return 1 where a benchmark was left out or did not come to its end, else 0."""
    folders = {"strogatz": options.strogatz, "dysts": options.dysts}
    campaign = Campaign(folders, revision(), options.file, load_figures())
    asked = [measurement for measurement in PLAN if not options.only or measurement.name in options.only]
    seeds_of = dict(options.seeds)
    chosen = {
        measurement.name: seeds_of.get(measurement.name, measurement.few if options.quick else measurement.seeds)
        for measurement in asked
    }
    plan, left = [], list[str]()
    for measurement in asked:
        why = (
            "it has no quick part" if options.quick and not chosen[measurement.name] else missing(measurement, folders)
        )
        if why:
            left.append(f"{measurement.name}: {why}")
        elif campaign.has(measurement, chosen[measurement.name]):
            note(f"{measurement.name}: measured already at {campaign.revision}")
        else:
            plan.append(measurement)
    end = None if options.minutes is None else time.monotonic() + 60.0 * options.minutes
    for number, measurement in enumerate(plan):
        share = measurement.minutes[options.quick] / math.fsum(later.minutes[options.quick] for later in plan[number:])
        limit = None if end is None else max(share * (end - time.monotonic()), 0.0)
        left += campaign.measure(measurement, chosen[measurement.name], limit)
    say(shown(campaign.known))
    say("\n" + "\n".join(["not measured, or not to the end:", *left] if left else ["all of the plan is measured"]))
    return 1 if left else 0


def shown(known: Figures) -> str:
    """Return the figures as a table."""
    heads = ("figure", "value", "runs", "seeds", "to the end", "revision", "engine", "date", "load")
    keys = ("figure", "runs", "seeds", "complete", "revision", "engine", "date", "load")
    return table(heads, [(name, *(_cell(known[name].get(key)) for key in keys)) for name in sorted(known)])


def _cell(value: object) -> str:
    return "-" if value is None else {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)


def documents() -> list[Path]:
    """Return README and the pages that quote figures."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def quoted(text: str, known: Figures) -> str:
    """Return a page with the figures of the file in all its marks; raises DataError where one is not in the file."""

    def replaced(mark: re.Match[str]) -> str:
        if mark["name"] not in known:
            raise DataError(f"no figure {mark['name']!r} is in {FILE.name}; measure it, or mend the mark")
        return f"<!-- figure: {mark['name']} -->{known[mark['name']]['figure']}<!-- end -->"

    return MARK.sub(replaced, text)


def quote() -> None:
    """Write the figures of the file into all pages, and say which changed."""
    known = load_figures()
    for page in documents():
        text = page.read_text("utf-8")
        following = quoted(text, known)
        if following != text:
            page.write_text(following, "utf-8")
            old, new = ([mark["text"] for mark in MARK.finditer(version)] for version in (text, following))
            moved = [f"{one} -> {other}" for one, other in zip(old, new, strict=True) if one != other]
            say(f"{page.relative_to(ROOT)}: {', '.join(moved)}")


def _seeds_of(text: str) -> tuple[str, str]:
    name, _, chosen = text.partition("=")
    if name not in {measurement.name for measurement in PLAN}:
        raise argparse.ArgumentTypeError(
            f"one of {', '.join(known.name for known in PLAN)} was expected before =, but {text!r} was given"
        )
    seeds(chosen)
    return name, chosen


@program(
    "benchmarks.figures",
    __doc__,
    verbs(
        verb(
            "measure",
            "run the benchmarks, write the figures to the file",
            option("--strogatz", type=Path, metavar="DIR", help="folder with the Strogatz label files"),
            option("--dysts", type=Path, metavar="DIR", help="chaotic flows, by benchmarks.dysts make --seed 2000"),
            option("--only", choices=[measurement.name for measurement in PLAN], nargs="+", help="default: all"),
            option("--quick", action="store_true", help="with few seeds: about half an hour"),
            option("--minutes", type=positive, help="bound of all of it, of which each benchmark has its share"),
            option("--seeds", type=_seeds_of, action="append", default=[], metavar="NAME=SEEDS", help="of one of them"),
            option("--file", type=Path, default=FILE, help="where figures are written (%(default)s)"),
        ),
        verb("show", "print the figures of the file"),
        verb("quote", "write the figures of the file into README and documentation"),
    ),
)
def main(options: Namespace) -> int:
    """Measure, show or quote."""
    if options.verb == "measure":
        return measure(options)
    if options.verb == "quote":
        quote()
    else:
        say(shown(load_figures()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
