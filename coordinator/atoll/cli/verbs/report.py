"""``coordinator report``: a result, saved or a job's, as one HTML page that needs neither network nor script."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from atoll.cli.analyses import ask
from atoll.cli.exit_codes import DONE
from atoll.cli.request import is_saved
from atoll.cli.result_files import REPORT, write_page
from atoll.model.shortcuts import write_text
from atoll.tasks.analyses import Report
from atoll.terminal.output import note
from atoll_core.errors import AtollError, UsageError


def report(options: argparse.Namespace) -> int:
    """Write the page of each of ``options.result``, and its pictures if they are wanted. Return the exit code.

    Of several, one that cannot be read keeps no other from its page; the exit code is that of the first such one.
    """
    paths = [Path(name) for name in options.result]
    if len(paths) == 1:
        _write(paths[0], options)
        return DONE
    _refuse_one_place(paths, options)
    code = DONE
    for path in paths:
        try:
            _write(path, options)
        except AtollError as error:
            note(f"coordinator: {error.on_command_line}")
            code = code or error.exit_code
    return code


def _refuse_one_place(paths: Sequence[Path], options: argparse.Namespace) -> None:
    """Raise UsageError where several pages would be written to one place."""
    for option, place in (("--output", options.output), ("--pictures", options.pictures)):
        if place is not None:
            raise UsageError(f"{option} names one place, but {len(paths)} results were given; leave it out")
    pages = [_page(path, options) for path in paths]
    twice = next((page for page in pages if pages.count(page) > 1), None)
    if twice is not None:
        raise UsageError(f"two of these results would be written to {twice}; give them one by one, with --output")


def _page(path: Path, options: argparse.Namespace) -> Path:
    """Return where the page of a result is written unless --output says otherwise; that of a job in this folder."""
    if not is_saved(str(path), options):
        return Path(f"{path.name}.html")
    return (path if path.is_dir() else path.parent) / REPORT


def _write(path: Path, options: argparse.Namespace) -> None:
    output = _page(path, options) if options.output is None else Path(options.output)
    (page,) = ask(options, Report(pictures=options.pictures is not None), name=str(path))
    write_page(output, page.text)
    if options.pictures is None:
        return
    folder = Path(options.pictures)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"the folder {folder} cannot be made ({error.strerror}); name another") from error
    for name, text in page.pictures.items():
        write_text(folder / name, text)
    note(f"{len(page.pictures)} pictures in {folder}")
