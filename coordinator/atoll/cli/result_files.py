"""Writes a result and its page into the folder that ``--out`` names."""

from pathlib import Path
from typing import TYPE_CHECKING, Final

from atoll.terminal.output import as_json, note
from atoll_core.errors import UsageError

if TYPE_CHECKING:
    from atoll_coordinator.result.result import Result

REPORT: Final = "report.html"
"""File name of the page, next to ``result.json``."""


def refuse_existing_result(folder: Path) -> None:
    """Raise UsageError if `folder` holds a result already, or is a file."""
    if (folder / "result.json").exists():
        raise UsageError(f"{folder / 'result.json'} exists already; name another folder with --out, or remove it")
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file, but --out names a folder; name another folder")


def write_result(folder: Path, result: "Result") -> Path:
    """Write ``result.json`` into `folder` as a whole or not at all, and return its path.

    Raises UsageError if there is a result already, or the folder cannot be written.
    """
    refuse_existing_result(folder)
    path, draft = folder / "result.json", folder / ".result.json.part"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        draft.write_text(as_json(result.as_dict()) + "\n", "utf-8")
        try:
            path.hardlink_to(draft)
        except FileExistsError:
            raise
        except OSError:  # a file system without hard links
            draft.replace(path)
        else:
            draft.unlink()
    except FileExistsError:
        raise UsageError(f"{path} exists already; name another folder with --out, or remove it") from None
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error.strerror}); name another folder with --out") from error
    return path


def write_report(path: Path, result: "Result") -> None:
    """Write the page of a result and print its path; raises UsageError if it cannot be written."""
    from atoll.tasks.analyses import Report, answer

    write_page(path, answer(result, Report()).text)


def write_page(path: Path, page: str) -> None:
    """Write a page and print its path; raises UsageError if it cannot be written."""
    from atoll_core.quoting import write_text

    write_text(path, page)
    note(f"report in {path}")
