"""From command to prompt: ``coordinator run`` on small tables, beside a script that imports PySINDy and fits the table.

Both are commands of a new process, in turn, so that both meet the same load. The script reads the table with pandas and
fits PySINDy's default model (quadratic terms, finite differences): the shortest script that gives equations. What it
finds is not judged here; ``benchmarks.corpus --methods`` does that, with a grid of settings. The groups of tables are

* ``example``: ``examples/lotka_volterra.csv``;
* ``textbook``: two states, without errors, by `solve_ivp` with its default tolerances, and with 1 % of noise;
* ``lorenz``: by `solve_ivp` with its default tolerances;
* ``noisy``: random systems of three to five states with 1 % of noise;
* ``second``: a second `atoll.discover` of the example in one process, beside the whole script.

PySINDy and pandas may be in another environment: ``--python /path/to/python``.
"""

import statistics
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

import atoll
from atoll.terminal.output import say
from atoll_core.errors import UsageError
from benchmarks.corpus.cases import Key, make_case
from benchmarks.harness.command_line import OUT, option, program, seeds, whole
from benchmarks.harness.record import Record
from benchmarks.harness.systems import Sampled, write_csv
from benchmarks.harness.tables import Columns, grouped

EXAMPLE: Final = Path(__file__).parents[2] / "examples" / "lotka_volterra.csv"
TEXTBOOK: Final = ("linear", "lotka_volterra", "van_der_pol", "pendulum")
QUALITIES: Final = ("exact", "rk45-1e-3", "noise-0.01")
GROUPS: Final = ("example", "second", "textbook", "lorenz", "noisy")
LIMIT_S: Final = 600.0
"""Time limit for a command."""

SCRIPT: Final = """
import sys
import pandas
import pysindy
table = pandas.read_csv(sys.argv[1])
names = [name for name in table.columns if name not in ("trajectory", "t")]
parts = [part for _, part in table.groupby("trajectory")]
model = pysindy.SINDy()
model.fit([part[names].to_numpy() for part in parts], t=[part["t"].to_numpy() for part in parts], feature_names=names)
model.print()
"""


@dataclass(frozen=True)
class Timing:
    """One table: `seconds` of the command and `script_seconds` of the script, medians of the repetitions."""

    group: str
    table: str
    seconds: float
    script_seconds: float

    @property
    def ratio(self) -> float:
        """How many times as long as the script the command takes."""
        return self.seconds / self.script_seconds


@dataclass(frozen=True)
class GroupTimings:
    """The tables of one group."""

    group: str
    timings: Sequence[Timing]

    @property
    def tables(self) -> int:
        """Number of tables."""
        return len(self.timings)

    @property
    def median(self) -> float:
        """Median seconds of the command."""
        return statistics.median(timing.seconds for timing in self.timings)

    @property
    def late(self) -> float:
        """Seconds within which 95 % of the commands ended."""
        return float(np.quantile([timing.seconds for timing in self.timings], 0.95))

    @property
    def script(self) -> float:
        """Median seconds of the script."""
        return statistics.median(timing.script_seconds for timing in self.timings)

    @property
    def ratio(self) -> float:
        """Median ratio of command and script."""
        return statistics.median(timing.ratio for timing in self.timings)


TIMES: Final = Columns(
    "group | tables | command s, median={median:.2f} | 95 %={late:.2f} | script s={script:.2f} | ratio={ratio:.2f}"
)


def keys(group: str, numbers: Sequence[int]) -> list[Key]:
    """Return the tables of a group; `numbers` are the seeds of drawn tables."""
    if group == "textbook":
        return [
            Key(name, 2, 1, "even", quality, seed) for name in TEXTBOOK for quality in QUALITIES for seed in numbers
        ]
    if group == "lorenz":
        return [Key("lorenz", 3, 1, "even", "rk45-1e-3", seed) for seed in numbers]
    return [Key("random", states, 4, "even", "noise-0.01", seed) for states in (3, 4, 5) for seed in numbers]


def tables(group: str, numbers: Sequence[int], folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield the titles and files of the tables of a group."""
    if group == "example":
        yield "example", EXAMPLE
        return
    for number, key in enumerate(keys(group, numbers)):
        table = make_case(key, has_fresh=False).table
        names = [name for name in table.names if name != "t"]
        path = folder / f"{group}-{number}.csv"
        ends = [*table.starts[1:], table.rows]
        parts = [slice(start, end) for start, end in zip(table.starts, ends, strict=True)]
        times, values = table.columns[table.names.index("t")], np.stack([table.column(name) for name in names], axis=1)
        write_csv(
            path, Sampled(tuple(names), tuple(times[part] for part in parts), tuple(values[part] for part in parts))
        )
        yield key.title, path


def seconds_of(command: Sequence[str]) -> float:
    """Run a command; return its seconds; raises UsageError when it fails."""
    begun = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    if done.returncode != 0:
        raise UsageError(f"`{' '.join(command[:3])} ...` failed: {(done.stderr or done.stdout).strip()[-300:]}")
    return time.monotonic() - begun


def seconds_of_discover() -> float:
    """Return the seconds of `atoll.discover` of the example; only the first call starts a service."""
    begun = time.monotonic()
    atoll.discover(EXAMPLE, progress=False)
    return time.monotonic() - begun


def measure(group: str, title: str, path: Path, python: str, repetitions: int, folder: Path) -> Timing:
    """Time both commands on a table, in turn."""
    ours: list[float] = []
    script: list[float] = []
    for number in range(repetitions):
        out = folder / f"result-{path.stem}-{number}"
        command = [sys.executable, "-m", "atoll", "run", str(path), "--out", str(out)]
        ours.append(seconds_of_discover() if group == "second" else seconds_of(command))
        script.append(seconds_of([python, "-c", SCRIPT, str(path)]))
    return Timing(group, title, statistics.median(ours), statistics.median(script))


@program(
    "benchmarks.peers.commands",
    __doc__,
    option("--groups", nargs="+", choices=GROUPS, default=GROUPS),
    option("--seeds", type=seeds, default="0-2", help="of drawn tables (%(default)s)"),
    option("--repetitions", type=whole, default=3, help="of each command, medians are taken (%(default)s)"),
    option("--python", default=sys.executable, help="interpreter that has PySINDy and pandas (this one)"),
    OUT,
)
def main(options: Namespace) -> None:
    """Measure and print a table."""
    seconds_of([options.python, "-c", "import pandas, pysindy"])
    record = Record("benchmarks.peers.commands", sys.argv[1:], options.out)
    timings: list[Timing] = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        for group in options.groups:
            if group == "second":
                seconds_of_discover()
            for title, path in tables("example" if group == "second" else group, options.seeds, folder):
                timings.append(measure(group, title, path, options.python, options.repetitions, folder))
                record.add(timings[-1])
                say(f"{group}: {title}: {timings[-1].seconds:.2f} s, script {timings[-1].script_seconds:.2f} s")
    groups: Mapping[str, list[Timing]] = grouped(timings, lambda timing: timing.group)
    say(TIMES.table([GroupTimings(group, each) for group, each in groups.items()]))


if __name__ == "__main__":
    sys.exit(main())
