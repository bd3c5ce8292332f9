"""Sixty small jobs that use most of what the command line offers, each a few seconds of one core, and their tables.

Every end is one of the search itself or a number of epochs, never the clock, so that a job's result depends on its
words and its files alone. Files have the same bytes whenever they are made with the same versions of packages.
"""

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from benchmarks.first_hour.cases import CASES
from benchmarks.first_hour.tables import csv_of, grid
from benchmarks.harness.systems import SYSTEMS, Sampled, solutions, trajectories, write_csv
from benchmarks.many.systems import SYSTEMS as MANY
from benchmarks.many.systems import lorenz96, sampled
from benchmarks.operations.side_by_side import write_labels
from benchmarks.peers.strogatz_files import LABEL, NAMES
from benchmarks.stochastic import processes
from benchmarks.stochastic.processes import PROCESSES, simulate

Words = tuple[str, ...]
Writer = Callable[[Path], None]

EXAMPLES: Final = ("lotka_volterra.csv", "pendulum.csv", "lynx_hare.csv")
LOTKA_VOLTERRA, PENDULUM, LYNX_HARE = EXAMPLES
EXACT: Final = ("--max-epochs", "3")
SHORT: Final = ("--max-epochs", "2", "--islands", "2", "--max-size", "11")
ONE: Final = ("--max-epochs", "1", "--islands", "2")
LABELLED: Final = ("--target", LABEL, "--max-epochs", "3")
THETAS: Final = ("--angle", "theta1", "--angle", "theta2")
STEPS: Final = 1500
"""Of the stochastic processes, which have 10,000 where they are measured."""

JOBS: Final[Mapping[str, Words]] = {
    "example lotka_volterra": (LOTKA_VOLTERRA,),
    "example pendulum": (PENDULUM, "--order", "2"),
    "example lynx_hare": (LYNX_HARE, "--time", "year", "--only", "hare", *SHORT),
    "pendulum 5 %, first order": ("pendulum-5.csv", "--order", "1", *SHORT),
    "preset paper": (LOTKA_VOLTERRA, "--preset", "paper", *EXACT),
    "preset paper, label": ("lv2.csv", "--preset", "paper", *LABELLED),
    "label lv1": ("lv1.csv", *LABELLED),
    "label lv1, seed 7": ("lv1.csv", *LABELLED, "--seed", "7"),
    "label lv2": ("lv2.csv", *LABELLED),
    "label vdp1": ("vdp1.csv", *LABELLED),
    "label glider1": ("glider1.csv", *LABELLED),
    "label bacres1": ("bacres1.csv", "--target", LABEL, *SHORT),
    "label predprey2": ("predprey2.csv", *LABELLED),
    "label barmag2": ("barmag2.csv", *LABELLED),
    "label vdp2, seed 3": ("vdp2.csv", *LABELLED, "--seed", "3"),
    "lotka_volterra 1 %": ("lotka_volterra-1.csv", *SHORT),
    "lotka_volterra 5 %, seed 7": ("lotka_volterra-5.csv", *SHORT, "--seed", "7"),
    "van_der_pol 1 %": ("van_der_pol-1.csv", *SHORT),
    "predator_prey 0 %": ("predator_prey-0.csv", *EXACT),
    "bacterial_respiration 1 %": ("bacterial_respiration-1.csv", *SHORT),
    "glider 5 %": ("glider-5.csv", "--angle", "theta", *SHORT),
    "bar_magnets 1 %": ("bar_magnets-1.csv", *THETAS, *SHORT),
    "pendulum 5 %": ("pendulum-5.csv", "--order", "2", "--angle", "theta", *SHORT),
    "angle in degrees": ("degrees.csv", "--order", "2", "--angle", "theta:deg", *SHORT),
    "missing values": ("missing.csv", "--only", "x", "--missing", "drop", *SHORT),
    "quantised": ("counted.csv", "--only", "x", *SHORT),
    "uneven times": ("uneven.csv", *EXACT),
    "lengths that differ": ("lengths.csv", *EXACT),
    "two files": ("lotka_volterra-0.csv", "lotka_volterra-0.csv", *EXACT),
    "one short trajectory": ("decay.csv",),
    "decimal commas": ("commas.csv",),
    "units of the header": ("units.csv", *SHORT),
    "units that are given": ("decay.csv", "--unit", "y=mol/L", "--unit", "t=h"),
    "an input": ("charged.csv", "--inputs", "u", *EXACT),
    "states and inputs of the example": (LYNX_HARE, "--time", "year", "--states", "hare", "--inputs", "lynx", *SHORT),
    "time as an input": ("forced.csv", "--inputs", "t", *EXACT),
    "target of the example": (LYNX_HARE, "--time", "year", "--target", "hare", *SHORT),
    "derivatives": ("derivatives.csv", "--derivatives", "dx,dy", *SHORT),
    "weights": ("weights.csv", "--only", "x", "--weights", "w", *SHORT),
    "robust": ("lotka_volterra-5.csv", "--only", "x", "--robust", *SHORT),
    "offsets": ("lotka_volterra-1.csv", "--offsets", "x", *SHORT),
    "holdout": (LOTKA_VOLTERRA, "--holdout", "1"),
    "only": (LOTKA_VOLTERRA, "--only", "x"),
    "guess": (LOTKA_VOLTERRA, "--guess", "dx=3*x-2*x*y", *EXACT),
    "known and required": (LOTKA_VOLTERRA, "--known", "dy=(2-x-y)*y", "--require", "x=y", *EXACT),
    "allowed variables and operators": (
        "lotka_volterra-1.csv", "--only", "x", "--allow", "x=x", "--operators", "x=+,-,*,sin", *SHORT,
    ),
    "operators": ("lotka_volterra-1.csv", "--operators", "+,-,*", *SHORT),
    "bounds": ("lotka_volterra-1.csv", "--only", "x", "--bound", "|c| < 2.5", "--bound", "x: x*y < 0", *SHORT),
    "job file": ("lotka_volterra-1.csv", "--config", "job.toml"),
    "groups": ("groups.csv", "--group", "strain", *SHORT),
    "constants of each trajectory": ("groups.csv", "--states", "x", "--per-trajectory", *SHORT),
    "stochastic, one state": ("ornstein_uhlenbeck.csv", "--stochastic", *SHORT),
    "stochastic, two states": ("duffing.csv", "--stochastic", *SHORT),
    "three states": ("lorenz.csv", *EXACT),
    "states that determine each other": ("epidemic.csv", "--only", "I", *SHORT),
    "six genes": ("repressilator.csv", *ONE),
    "six states on a ring": ("lorenz96-6.csv", *ONE),
    "nine shares of an epidemic": ("sir.csv", *ONE),
    "eight states on a ring": ("lorenz96-8.csv", "--only", "x1,x5", *ONE),
    "no law": ("walk.csv", *SHORT),
}  # fmt: skip
"""The words of the command line by name of the job; what ends in .csv or .toml is a file of `write_files`."""


def files_of(words: Sequence[str]) -> list[str]:
    """Return the names of the files among the words of a job."""
    return [word for word in words if word.endswith((".csv", ".toml"))]


def write_files(folder: Path, names: Iterable[str], strogatz: Path | None) -> None:
    """Write these files into `folder`.

    Label files are those of the folder `strogatz` where it is given, else files like them.
    """
    wanted = {*names}
    for name in wanted & {*EXAMPLES}:
        shutil.copyfile(Path("examples") / name, folder / name)
    _write_labels(folder, wanted & {f"{name}.csv" for name in NAMES}, strogatz)
    for name in sorted(wanted & {*WRITERS}):
        WRITERS[name](folder / name)


def _write_labels(folder: Path, wanted: set[str], strogatz: Path | None) -> None:
    with TemporaryDirectory() as name:
        made = [path for _, path in write_labels(Path(name))] if wanted and strogatz is None else []
        files = dict(zip((f"{label}.csv" for label in NAMES), made, strict=False))
        for file in wanted:
            shutil.copyfile(files[file] if strogatz is None else strogatz / file, folder / file)


def _of_system(system: str, percent: int, path: Path) -> None:
    system_data = trajectories(system, 0.2, seed=1, noise=percent / 100)
    write_csv(path, replace(system_data, times=system_data.times[:2], values=system_data.values[:2]))


def _of_many(system: str, path: Path) -> None:
    chosen = lorenz96(6) if system == "lorenz96-6" else MANY[system]
    measured, _ = sampled(replace(chosen, runs=4, points=101), 1)
    write_csv(path, measured)


def _of_process(process: str, path: Path) -> None:
    write_csv(path, processes.sampled(PROCESSES[process], simulate(PROCESSES[process], 1, STEPS)))


def _of_case(case: str, path: Path) -> None:
    path.write_text(csv_of(CASES[case].make(), {}), "utf-8")


def _of_times(lengths: Sequence[int], is_even: bool, path: Path) -> None:
    """Write trajectories of Lotka and Volterra's system with so many rows, at times that are even or drawn."""
    draw, system = np.random.default_rng(4), SYSTEMS["lotka_volterra"]
    even = [0.1 * np.arange(rows, dtype=np.float64) for rows in lengths]
    times = even if is_even else [np.sort(draw.uniform(0.0, even_times[-1], len(even_times))) for even_times in even]
    write_csv(path, Sampled(system.states, tuple(times), tuple(solutions(system, times, draw))))


def _changed(change: Callable[[int, list[str]], list[str]], path: Path) -> None:
    """Write Lotka and Volterra's system with 1 % of noise, each line's cells changed; the header is line 0."""
    _of_system("lotka_volterra", 1, path)
    lines = path.read_text("utf-8").splitlines()
    path.write_text("".join(",".join(change(i, line.split(","))) + "\n" for i, line in enumerate(lines)), "utf-8")


def _with_holes(line: int, cells: list[str]) -> list[str]:
    return [*cells[:3], ""] if line % 37 == 5 else [*cells[:2], "", cells[3]] if line % 41 == 7 else cells


def _with_weight(line: int, cells: list[str]) -> list[str]:
    return [*cells, "w" if line == 0 else str(1 + line % 3)]


def _in_units(line: int, cells: list[str]) -> list[str]:
    return ["trajectory", "t [h]", "x [ind]", "y (ind)"] if line == 0 else cells


def _degrees(path: Path) -> None:
    pendulum = trajectories("pendulum", 0.1, seed=1, noise=0.01)
    turned = tuple((180.0 + np.degrees(angles)) % 360.0 - 180.0 for angles in pendulum.values[:2])
    write_csv(path, replace(pendulum, times=pendulum.times[:2], values=turned))


def _commas(path: Path) -> None:
    columns = CASES["predator and prey"].make()
    rows = zip(*(columns[name][:120].tolist() for name in ("t", "x", "y")), strict=True)
    lines = [";".join(f"{cell:.6f}" for cell in row).replace(".", ",") for row in rows]
    path.write_text("\n".join(["# counted by day", "t;x;y", *lines]) + "\n", "utf-8")


def _forced(path: Path) -> None:
    times = grid(300, 0.05)
    path.write_text(csv_of({"t": times, "x": 0.5 * np.sin(times) - 0.5 * np.cos(times)}, {}), "utf-8")


def _derivatives(path: Path) -> None:
    draw = np.random.default_rng(5)
    x, y = draw.uniform(0.5, 4.0, (2, 120))
    slopes = SYSTEMS["lotka_volterra"].field(x, y)
    noisy = {name: slope + 0.05 * draw.standard_normal(120) for name, slope in zip(("dx", "dy"), slopes, strict=True)}
    path.write_text(csv_of({"t": grid(120, 1.0), "x": x, "y": y, **noisy}, {}), "utf-8")


def _groups(path: Path) -> None:
    """Write logistic growth of three strains, each with a rate of its own, with 1 % of noise."""
    times, draw, parts = grid(60, 0.2), np.random.default_rng(6), []
    for strain, rate in enumerate((0.25, 0.5, 0.85)):
        x = 2.0 / (1.0 + 9.0 * np.exp(-rate * times)) + 0.005 * draw.standard_normal(60)
        parts.append(np.array([np.full(60, strain), np.full(60, strain), times, x]))
    names = ("strain", "trajectory", "t", "x")
    path.write_text(csv_of(dict(zip(names, np.concatenate(parts, axis=1), strict=True)), {}), "utf-8")


def _job_file(path: Path) -> None:
    path.write_text(
        "seed = 5\n[data]\nunits = {x = 'm', t = 's'}\n[budget]\nmax_epochs = 3\n[space]\n"
        "variables_of = {y = ['x', 'y']}\n[prior]\nguesses = {x = ['3*x - 2*x*y']}\n",
        "utf-8",
    )


WRITERS: Final[Mapping[str, Writer]] = {
    **{
        f"{system}-{percent}.csv": partial(_of_system, system, percent)
        for system, percent in (
            *(("lotka_volterra", percent) for percent in (0, 1, 5)),
            *((system, 1) for system in ("van_der_pol", "bacterial_respiration", "bar_magnets")),
            *(("predator_prey", 0), ("glider", 5), ("pendulum", 5)),
        )
    },
    **{f"{system}.csv": partial(_of_many, system) for system in ("repressilator", "lorenz96-6", "lorenz96-8", "sir")},
    "ornstein_uhlenbeck.csv": partial(_of_process, "Ornstein-Uhlenbeck"),
    "duffing.csv": partial(_of_process, "Duffing"),
    "counted.csv": partial(_of_case, "animals counted by ones"),
    "decay.csv": partial(_of_case, "decay"),
    "charged.csv": partial(_of_case, "charged through a switch of 0 and 1"),
    "lorenz.csv": partial(_of_case, "Lorenz"),
    "epidemic.csv": partial(_of_case, "S + I + R = 1, 1 % of noise"),
    "walk.csv": partial(_of_case, "random walk, seed 0"),
    "uneven.csv": partial(_of_times, (100, 100), False),
    "lengths.csv": partial(_of_times, (40, 70, 110), True),
    "missing.csv": partial(_changed, _with_holes),
    "weights.csv": partial(_changed, _with_weight),
    "units.csv": partial(_changed, _in_units),
    "degrees.csv": _degrees,
    "commas.csv": _commas,
    "forced.csv": _forced,
    "derivatives.csv": _derivatives,
    "groups.csv": _groups,
    "job.toml": _job_file,
}
