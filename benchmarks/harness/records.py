"""Records of runs that are not verdicts on equations: written as JSON after each, with the machine and its load."""

import json
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.harness.reporting import load, machine


class Records:
    """Collects dataclasses as they come, and writes the file anew each time, so that an interrupt costs nothing."""

    def __init__(self, benchmark: str, arguments: Sequence[str], out: Path | None) -> None:
        """Begin the file `out` of `benchmark`, called with `arguments`; None: no file."""
        self._out = out
        self._records: list[dict[str, Any]] = []
        self._head = {
            "benchmark": benchmark,
            "arguments": list(arguments),
            "date": time.strftime("%Y-%m-%d %H:%M"),
            "machine": machine(),
            "load_before": load(),
        }

    def add(self, record: Any) -> None:
        """Take in a dataclass of plain values."""
        self._records.append(asdict(record))
        self.write()

    def write(self, **figures: Any) -> None:
        """Write all records, and `figures` beside them."""
        if self._out is None:
            return
        contents = {**self._head, "load_after": load(), "runs": self._records, **figures}
        self._out.parent.mkdir(parents=True, exist_ok=True)
        self._out.write_text(json.dumps(contents, indent=1, ensure_ascii=False) + "\n", "utf-8")
