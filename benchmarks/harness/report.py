"""Verdicts on the equations of many searches: a table, the misses, and a file."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from atoll.terminal.output import note, say
from benchmarks.harness.record import Record, load
from benchmarks.judging.verdict import COLUMNS, Verdict, miss


class Report:
    """Collects verdicts as they come, and presents them."""

    def __init__(self, benchmark: str, arguments: Sequence[str], out: Path | None) -> None:
        self.verdicts: list[Verdict] = []
        self._figures: dict[str, dict[str, Any]] = {}
        self._record = Record(benchmark, arguments, out)

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
        say(COLUMNS.table(self.verdicts))
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
        self._record.write(verdicts=[asdict(verdict) for verdict in self.verdicts], **self._figures)
