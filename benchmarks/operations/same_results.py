"""Whether two revisions find the same: many jobs run by an installed ``coordinator``, and two such runs compared.

``python -m benchmarks.operations.same_results run --data DIR --out before.json [--program .venv/bin/coordinator]``
runs the jobs and writes what they found; ``... compare before.json after.json`` prints every job that differs and ends
with 1 if there is one. Data files are made on the first run and read by the second, so that both see the same bytes.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from benchmarks.harness.systems import TABLE_III, trajectories, write_csv

NOT_COMPARED: Final = {"job", "seconds", "search_seconds", "versions"}
"""Keys of ``result.json`` that say when and by what a job was run, not what it found."""

SYSTEM_OPTIONS: Final[dict[str, tuple[str, ...]]] = {
    "bar_magnets": ("--angle", "theta1", "--angle", "theta2"),
    "glider": ("--angle", "theta"),
}

EXAMPLES: Final[dict[str, tuple[str, ...]]] = {
    "example lotka_volterra": ("examples/lotka_volterra.csv",),
    "example pendulum": ("examples/pendulum.csv", "--order", "2"),
    "example lynx_hare": ("examples/lynx_hare.csv", "--time", "year"),
    "first order": ("examples/pendulum.csv", "--order", "1"),
    "paper preset": ("examples/lotka_volterra.csv", "--preset", "paper"),
    "operators": ("examples/lotka_volterra.csv", "--operators", "+,-,*"),
    "holdout": ("examples/lotka_volterra.csv", "--holdout", "1"),
    "only": ("examples/lotka_volterra.csv", "--only", "x"),
    "guess": ("examples/lotka_volterra.csv", "--guess", "dx=3*x-2*x*y"),
    "known": ("examples/lotka_volterra.csv", "--known", "dy=(2-x-y)*y"),
    "allow": ("examples/lotka_volterra.csv", "--allow", "x=x"),
    "operators of one": ("examples/lotka_volterra.csv", "--operators", "x=+,-,*,sin"),
    "target": ("examples/lynx_hare.csv", "--time", "year", "--target", "hare"),
    "input": ("examples/lynx_hare.csv", "--time", "year", "--states", "hare", "--inputs", "lynx"),
    "time as input": ("{data}/forced.csv", "--inputs", "t"),
    "robust": ("{data}/lotka_volterra-5.csv", "--robust"),
    "offsets": ("{data}/lotka_volterra-1.csv", "--offsets", "x"),
    "weights": ("{data}/weighted.csv", "--weights", "w"),
    "derivatives": ("{data}/derivatives.csv", "--derivatives", "dx,dy"),
    "several files": ("{data}/lotka_volterra-0.csv", "{data}/lotka_volterra-0.csv"),
    "seed 7": ("{data}/lotka_volterra-5.csv", "--seed", "7"),
    "missing": ("{data}/missing.csv", "--missing", "drop"),
}


def make_data(folder: Path) -> None:
    """Write every data file that is not there yet."""
    import numpy as np

    folder.mkdir(parents=True, exist_ok=True)
    for system in TABLE_III:
        for percent in (0, 1, 5):
            path = folder / f"{system}-{percent}.csv"
            if not path.exists():
                write_csv(path, trajectories(system, 0.1, seed=1, noise=percent / 100))
    rows = [line.split(",") for line in (folder / "lotka_volterra-1.csv").read_text().splitlines()[1:]]
    rng = np.random.default_rng(0)
    weights = rng.integers(1, 4, len(rows))
    made = {
        "forced.csv": [
            "t,x",
            *(f"{0.05 * i:.17g},{0.5 * np.sin(0.05 * i) - 0.5 * np.cos(0.05 * i):.17g}" for i in range(300)),
        ],
        "weighted.csv": [
            "trajectory,t,x,y,w",
            *(",".join([*row, str(w)]) for row, w in zip(rows, weights, strict=True)),
        ],
        "missing.csv": [
            "trajectory,t,x,y",
            *(",".join([*row[:3], "" if i % 37 == 5 else row[3]]) for i, row in enumerate(rows)),
        ],
        "derivatives.csv": ["t,x,y,dx,dy", *_with_derivatives(rng)],
    }
    for name, lines in made.items():
        if not (folder / name).exists():
            (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _with_derivatives(rng: Any) -> list[str]:
    points = rng.uniform(0.5, 4.0, (120, 2)).tolist()
    lines = []
    for i, (x, y) in enumerate(points):
        noise = 0.05 * rng.standard_normal(2)
        dx, dy = 3 * x - 2 * x * y - x * x + noise[0], 2 * y - x * y - y * y + noise[1]
        lines.append(f"{i},{x:.17g},{y:.17g},{dx:.17g},{dy:.17g}")
    return lines


def jobs(strogatz: Path | None) -> dict[str, tuple[str, ...]]:
    """Return the options of every job by its name."""
    chosen = dict(EXAMPLES)
    for system in TABLE_III:
        for percent in (0, 1, 5):
            chosen[f"{system} {percent} %"] = (f"{{data}}/{system}-{percent}.csv", *SYSTEM_OPTIONS.get(system, ()))
    for file in sorted(strogatz.glob("*.csv")) if strogatz else ():
        chosen[f"label {file.stem}"] = (str(file), "--target", "label")
    return chosen


def run_job(program: Path, options: Sequence[str]) -> dict[str, Any]:
    """Return what one job found: its result without times, the text that is printed of it, and its exit code."""
    with TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        command = [
            str(program),
            "run",
            *options,
            "--workers",
            "2",
            "--max-epochs",
            "3",
            "--id",
            "same",
            "--out",
            str(out),
        ]
        ended = subprocess.run([*command, "--json"], capture_output=True, text=True, timeout=900, check=False)
        if not ended.stdout.strip():
            return {"exit": ended.returncode, "error": ended.stderr.strip().splitlines()[-1:]}
        result = json.loads(ended.stdout)
        shown = subprocess.run([str(program), "result", str(out)], capture_output=True, text=True, check=False)
        text = [line for line in shown.stdout.splitlines() if "point evaluations in" not in line]
        return {"exit": ended.returncode, "digest": result.get("digest"), "result": without_times(result), "text": text}


def without_times(value: Any) -> Any:
    """Return `value` without the keys `NOT_COMPARED`, at any depth."""
    if isinstance(value, dict):
        return {key: without_times(each) for key, each in value.items() if key not in NOT_COMPARED}
    return [without_times(each) for each in value] if isinstance(value, list) else value


def differing(before: dict[str, Any], after: dict[str, Any]) -> dict[str, list[str]]:
    """Return, for each job that differs, the keys in which it does."""
    found = {}
    for name in sorted({*before, *after}):
        one, other = before.get(name), after.get(name)
        if one != other:
            found[name] = _differing_keys(one, other)
    return found


def _differing_keys(one: Any, other: Any, place: str = "") -> list[str]:
    if isinstance(one, dict) and isinstance(other, dict):
        return [
            key
            for name in sorted({*one, *other})
            for key in _differing_keys(one.get(name), other.get(name), f"{place}.{name}")
        ]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        return [
            key
            for i, pair in enumerate(zip(one, other, strict=True))
            for key in _differing_keys(*pair, f"{place}[{i}]")
        ]
    return [] if one == other else [f"{place.lstrip('.')}: {str(one)[:80]} -> {str(other)[:80]}"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the jobs, or compare two files of what they found."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    running = verbs.add_parser("run")
    running.add_argument("--data", type=Path, required=True)
    running.add_argument("--strogatz", type=Path, help="folder of label files")
    running.add_argument("--program", type=Path, default=Path(".venv/bin/coordinator"))
    running.add_argument("--out", type=Path, required=True)
    running.add_argument("--only", help="jobs whose name contains this")
    comparing = verbs.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    options = parser.parse_args(arguments)
    if options.verb == "compare":
        before, after = json.loads(options.before.read_text()), json.loads(options.after.read_text())
        found = differing(before, after)
        for name, keys in found.items():
            print(f"{name} differs:", *keys[:6], sep="\n    ")
        digests = sum(before.get(name, {}).get("digest") == each.get("digest") for name, each in after.items())
        print(f"{len(after)} jobs, {digests} equal in digest, {len(after) - len(found)} equal in all")
        sys.exit(1 if found else 0)
    make_data(options.data)
    found = json.loads(options.out.read_text()) if options.out.exists() else {}
    for name, words in jobs(options.strogatz).items():
        if name in found or (options.only and options.only not in name):
            continue
        found[name] = run_job(options.program, [word.replace("{data}", str(options.data)) for word in words])
        options.out.write_text(json.dumps(found, indent=1))
        print(name, found[name].get("digest"), found[name]["exit"], found[name].get("error", ""), flush=True)


if __name__ == "__main__":
    main()
