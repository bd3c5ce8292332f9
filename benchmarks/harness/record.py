"""The JSON file of a benchmark: what was measured, beside the command, the date, the machine and its load."""

import json
import math
import os
import platform
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from atoll_coordinator.model.result.building import versions
from atoll_core.errors import UsageError


class Record:
    """Collects figures as they come and writes the whole file anew each time, so that an interrupt loses nothing."""

    def __init__(self, benchmark: str, arguments: Sequence[str], out: Path | None) -> None:
        """Begin the file `out` of `benchmark`, called with `arguments`; None: no file."""
        self._out = out
        self._began = time.monotonic()
        self._runs: list[dict[str, Any]] = []
        self._head = head(benchmark, arguments)

    def seconds(self) -> float:
        """Return the time since the benchmark began."""
        return time.monotonic() - self._began

    def add(self, run: Any) -> None:
        """Take in one run, a dataclass of plain values, and write the file."""
        self._runs.append(asdict(run))
        self.write()

    def write(self, **figures: Any) -> None:
        """Write the runs, and `figures` by name beside them, null for what is not finite; raises UsageError."""
        if self._out is None:
            return
        runs = {"runs": self._runs} if self._runs else {}
        contents = {**self._head, "load_after": load(), "seconds": self.seconds(), **runs, **figures}
        text = json.dumps(_finite(contents), indent=1, ensure_ascii=False, allow_nan=False)
        try:
            self._out.parent.mkdir(parents=True, exist_ok=True)
            self._out.write_text(text + "\n", "utf-8")
        except OSError as error:
            message = f"{self._out} cannot be written ({error.strerror}); name another file with --out"
            raise UsageError(message) from error


def head(benchmark: str, arguments: Sequence[str]) -> dict[str, Any]:
    """Return what figures depend on: the command, the date, the machine and its load."""
    return {
        "benchmark": benchmark,
        "arguments": list(arguments),
        "date": time.strftime("%Y-%m-%d %H:%M"),
        "machine": machine(),
        "load_before": load(),
    }


def machine() -> dict[str, Any]:
    """Return what the figures depend on: processor, cores, system and versions."""
    return {"processor": _processor(), "cores": os.cpu_count(), "system": platform.platform(), "versions": versions()}


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


def _finite(value: Any) -> Any:
    """Return `value` with null in place of every number that JSON cannot hold, at any depth."""
    if isinstance(value, Mapping):
        return {key: _finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
