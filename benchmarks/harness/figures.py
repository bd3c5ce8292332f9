"""The JSON file of a benchmark that measures speeds rather than verdicts: its figures, the machine and its load."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from atoll.errors import UsageError
from benchmarks.harness.reporting import load, machine


def write_figures(out: Path | None, benchmark: str, arguments: Sequence[str], figures: Mapping[str, Any]) -> None:
    """Write `figures`, by name, to `out` with all that they depend on; nothing when `out` is None.

    Raises:
        UsageError: the file cannot be written.
        ValueError: a figure is not finite, which JSON cannot hold.
    """
    if out is None:
        return
    head = {"benchmark": benchmark, "arguments": list(arguments), "machine": machine(), "load": load()}
    text = json.dumps({**head, **figures}, indent=1, ensure_ascii=False, allow_nan=False)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text + "\n", "utf-8")
    except OSError as error:
        raise UsageError(f"{out} cannot be written ({error.strerror}); name another file with --out") from error
