"""``coordinator report``: a saved result as one HTML page that needs neither network nor script."""

import argparse
from pathlib import Path

from atoll.errors import UsageError
from atoll.model.model import Model
from atoll.model.saved import read_result, write_text
from atoll.report.page import as_text, build_page, pictures
from atoll_coordinator.cli.exit_codes import DONE
from atoll_coordinator.cli.terminal.output import REPORT, note


def report(options: argparse.Namespace) -> int:
    """Write the page of ``options.result``, and its pictures if they are wanted. Return the exit code."""
    path = Path(options.result)
    output = (path if path.is_dir() else path.parent) / REPORT if options.output is None else Path(options.output)
    found = read_result(path)
    page = build_page(found if options.group is None else Model(found).of_group(options.group).result)
    write_text(output, as_text(page))
    note(f"report in {output}")
    if options.pictures is not None:
        _write_pictures(Path(options.pictures), pictures(page))
    return DONE


def _write_pictures(folder: Path, drawn: dict[str, str]) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"the folder {folder} cannot be made ({error.strerror}); name another") from error
    for name, text in drawn.items():
        write_text(folder / name, text)
    note(f"{len(drawn)} pictures in {folder}")
