"""Time to solution of the 14 Strogatz equations, ours and Operon's, in turn on the same machine."""

import statistics
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from atoll.terminal.output import error_text, note, say, table
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import Searches
from benchmarks.harness.tables import grouped
from benchmarks.judging.errors import finite, values_on
from benchmarks.peers import operon
from benchmarks.peers.operon import search_apart
from benchmarks.peers.strogatz_files import LABEL, rows_of


@dataclass(frozen=True)
class Race:
    """Seconds until each program met the target on one file, None where it did not within the limit.

    The errors are the mean absolute ones on all rows over the label's deviation, measured in the same way for both.
    `load` is how many processes wanted a core in the minute before.
    """

    file: str
    seed: int
    ours: float | None
    our_error: float | None
    our_expression: str | None
    our_evaluations: int
    peers: float | None
    peers_error: float | None
    peers_expression: str
    peers_evaluations: int
    peers_processor_seconds: float
    load: float


def run(
    searches: Searches, options: Namespace, configs: Mapping[int, JobConfig], known: Mapping[str, str], records: Record
) -> int:
    """Let both search all files to the same target with equal seeds, one after the other, and print the times.

    Returns 0 when ours met the target in every run.
    """
    races: list[Race] = []
    for name in options.file or known:
        rows = rows_of(options.data, name)
        for seed in options.seeds:
            result = searches.solve(f"{name} seed {seed}", rows, configs[seed])
            peer = search_apart(options.data / f"{name}.csv", seed, options.target_error, options.max_time)
            races.append(race((name, seed), result, rows, peer, options.target_error))
            records.add(races[-1])
            note(f"{name} seed {seed}: {_seconds(races[-1].ours)} s, Operon {_seconds(races[-1].peers)} s")
    limit = options.max_time
    records.write(summary=summary(races, limit))
    say(by_file(races, limit))
    say("\n" + totals(races, limit))
    return 0 if all(race.ours is not None for race in races) else 1


def race(key: tuple[str, int], result: Mapping[str, Any], rows: Table, peer: operon.Run, target_error: float) -> Race:
    """Put the `result` (the contents of a result.json) of the search `key`, file and seed, beside the `peer`'s."""
    (equation,) = result["equations"]
    text = equation["expression"]
    error = measured_error(text, rows) if text else None
    return Race(
        file=key[0],
        seed=key[1],
        ours=result["search_seconds"] if error is not None and error <= target_error else None,
        our_error=error,
        our_expression=text,
        our_evaluations=equation["point_evaluations"],
        peers=peer.seconds,
        peers_error=peer.error,
        peers_expression=peer.expression,
        peers_evaluations=peer.evaluations,
        peers_processor_seconds=peer.processor_seconds,
        load=load(),
    )


def measured_error(expression: str, rows: Table) -> float | None:
    """Return the mean of |value - label| over label's deviation on all rows; None when it is not finite."""
    values = values_on(expression, {name: rows.column(name) for name in rows.names if name != LABEL})
    label: FloatArray = rows.column(LABEL)
    return finite(float(abs(values - label).mean() / label.std()))


def by_file(races: Sequence[Race], limit: float) -> str:
    """Return a table with medians for each file; a run that missed the target counts as `limit` seconds."""
    heads = ("file", "median s", "longest s", "met", "Operon s", "longest s", "met", "ratio")
    rows = []
    for file, chosen in grouped(races, lambda race: race.file).items():
        ours, peers = _medians(chosen, limit)
        cells = (*_cells([race.ours for race in chosen], limit), *_cells([race.peers for race in chosen], limit))
        rows.append((file, *cells, f"{ours / peers:.3f}"))
    return table(heads, rows)


def totals(races: Sequence[Race], limit: float) -> str:
    """Return the figures over all runs in a few lines."""
    figures = summary(races, limit)
    worst = max(races, key=lambda race: counted(race.ours, limit))
    ours = f"{figures['met']} of {len(races)} met the target, geometric mean {figures['mean_s']:.3f} s"
    peers = f"{figures['peers_met']} of {len(races)} met the target, geometric mean {figures['peers_mean_s']:.3f} s"
    worst_error = error_text(figures["largest_error"])
    lines = (
        f"ours:   {ours}, slowest {figures['slowest_s']:.2f} s ({worst.file} seed {worst.seed})",
        f"Operon: {peers}, slowest {figures['peers_slowest_s']:.2f} s",
        f"ratio of the geometric means {figures['ratio']:.3f}, "
        f"geometric mean of the files' ratios {figures['file_ratio']:.3f}",
        f"largest error of ours that met it {worst_error}; load {figures['load']:.1f}; limit {limit:g} s",
    )
    return "\n".join(lines)


def summary(races: Sequence[Race], limit: float) -> dict[str, Any]:
    """Return the figures over all runs."""
    ours, peers = ([counted(get(race), limit) for race in races] for get in _SIDES)
    by_files = [_medians(chosen, limit) for chosen in grouped(races, lambda race: race.file).values()]
    mean, peers_mean = statistics.geometric_mean(ours), statistics.geometric_mean(peers)
    return {
        "met": sum(race.ours is not None for race in races),
        "mean_s": mean,
        "slowest_s": max(ours),
        "peers_met": sum(race.peers is not None for race in races),
        "peers_mean_s": peers_mean,
        "peers_slowest_s": max(peers),
        "ratio": mean / peers_mean,
        "file_ratio": statistics.geometric_mean([mine / other for mine, other in by_files]),
        "largest_error": max((race.our_error or 0.0 for race in races if race.ours is not None), default=None),
        "load": statistics.median(race.load for race in races),
    }


_SIDES: tuple[Callable[[Race], float | None], ...] = (lambda race: race.ours, lambda race: race.peers)


def counted(seconds: float | None, limit: float) -> float:
    """Return the seconds that a run counts: `limit` when it missed the target, at least a millisecond."""
    return limit if seconds is None else max(seconds, 1e-3)


def _medians(races: Sequence[Race], limit: float) -> tuple[float, float]:
    ours, peers = (statistics.median(counted(get(race), limit) for race in races) for get in _SIDES)
    return ours, peers


def _cells(seconds: Sequence[float | None], limit: float) -> tuple[str, str, str]:
    values = [counted(second, limit) for second in seconds]
    met = sum(time_s is not None for time_s in seconds)
    return f"{statistics.median(values):.2f}", f"{max(values):.2f}", f"{met} of {len(seconds)}"


def _seconds(seconds: float | None) -> str:
    return "missed" if seconds is None else f"{seconds:.2f}"
