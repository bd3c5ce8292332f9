"""What the benchmarks of whole searches print, and the JSON they write: always with the machine and its load."""

import argparse
import json
import os
import platform
import re
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from atoll.errors import AtollError
from atoll_coordinator.cli.terminal.output import note, say, table
from atoll_coordinator.model.report.result import versions
from benchmarks.judging.verdict import HEADS, MORE_HEADS, Verdict, cells, miss


def seeds(text: str) -> list[int]:
    """Return the numbers of ``0-4``, ``3`` or ``0,2,5-7``."""
    numbers: list[int] = []
    for part in text.split(","):
        if not re.fullmatch(r"\d+(-\d+)?", part):
            raise argparse.ArgumentTypeError(f"numbers such as 0-4 or 0,2,5 were expected, but {text!r} was given")
        first, _, last = part.partition("-")
        numbers += range(int(first), int(last or first) + 1)
    return numbers


def add_common(parser: argparse.ArgumentParser, default_seeds: str, default_time: float) -> None:
    """Add the options that the benchmarks of searches have in common."""
    parser.add_argument("--seeds", type=seeds, default=seeds(default_seeds), help=f"such as 0-4 ({default_seeds})")
    parser.add_argument("--workers", type=int, default=2, help="worker processes (%(default)s)")
    parser.add_argument(
        "--max-time", type=float, default=default_time, metavar="SECONDS", help="end of a search (%(default)g)"
    )
    parser.add_argument("--out", type=Path, help="file for all figures as JSON")


def machine() -> dict[str, Any]:
    """Return what the figures depend on: processor, cores, system and versions."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "versions": versions(),
    }


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        match = re.search(r"^model name\s*:\s*(.+)$", information.read_text("utf-8"), re.MULTILINE)
        if match:
            return match[1]
    return platform.processor() or platform.machine()


def load() -> float:
    """Return how many processes wanted a core in the last minute."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")


class Report:
    """Collects verdicts as they come, and presents them."""

    def __init__(self, benchmark: str, arguments: Sequence[str], out: Path | None) -> None:
        self.verdicts: list[Verdict] = []
        self._figures: dict[str, dict[str, Any]] = {}
        self._out = out
        self._head = {
            "benchmark": benchmark,
            "arguments": list(arguments),
            "date": time.strftime("%Y-%m-%d %H:%M"),
            "machine": machine(),
            "load_before": load(),
        }

    def add(self, verdicts: Sequence[Verdict], **figures: dict[str, Any]) -> None:
        """Take in the verdicts of one search; say on stderr how it came out, and write the file anew.

        `figures` are further ones for the file; those of the same name are put together.
        """
        self.verdicts += verdicts
        for name, values in figures.items():
            self._figures.setdefault(name, {}).update(values)
        found = sum(verdict.found for verdict in verdicts)
        first = verdicts[0]
        note(f"{first.case} seed {first.seed}: {found} of {len(verdicts)} found in {first.seconds:.1f} s")
        for verdict in verdicts:
            if not verdict.found:
                note(f"  missed: {miss(verdict)}")
        self._write()

    def show(self) -> None:
        """Print the table, the misses and the sum."""
        say(table((*HEADS, *MORE_HEADS), [cells(verdict) for verdict in self.verdicts]))
        missed = [verdict for verdict in self.verdicts if not verdict.found]
        if missed:
            say("\nmissed:\n" + "\n".join(miss(verdict) for verdict in missed))
        say(f"\n{self.summary()}")
        self._write()

    def summary(self) -> str:
        """Return the figures in a line."""
        found = sum(verdict.found for verdict in self.verdicts)
        converged = sum(verdict.converged for verdict in self.verdicts)
        seconds = sorted({(each.case, each.seed): each.seconds for each in self.verdicts}.values())
        times = f"median {seconds[len(seconds) // 2]:.2f} s, longest {seconds[-1]:.2f} s" if seconds else "no search"
        exact, singular = sum(each.exact for each in self.verdicts), sum(each.is_singular for each in self.verdicts)
        counts = f"{found} of {len(self.verdicts)} found: {exact} exact in form, {singular} flagged as singular"
        return f"{counts}; {converged} converged; {times}; load {load():.1f}"

    def _write(self) -> None:
        if self._out is None:
            return
        verdicts = [asdict(verdict) for verdict in self.verdicts]
        contents = {**self._head, "load_after": load(), "verdicts": verdicts, **self._figures}
        self._out.parent.mkdir(parents=True, exist_ok=True)
        self._out.write_text(json.dumps(contents, indent=1, ensure_ascii=False) + "\n", "utf-8")


@contextmanager
def plain_errors(program: str) -> Iterator[None]:
    """Turn errors meant for a person into a sentence and their exit code, an interrupt into 130."""
    try:
        yield
    except AtollError as error:
        note(f"{program}: {error}")
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        note(f"{program}: interrupted; what it had by then is in the file given by --out, if any")
        sys.exit(130)
