"""The files of a result in the folder that ``--out`` names."""

from pathlib import Path
from typing import Any, Final

from atoll.terminal.output import as_json, note
from atoll_core.errors import UsageError

REPORT: Final = "report.html"
"""The page of a result, beside it."""


def refuse_existing_result(folder: Path) -> None:
    """Raise UsageError when `folder` holds a result already, or cannot hold one."""
    if (folder / "result.json").exists():
        raise UsageError(f"{folder / 'result.json'} exists already; name another folder with --out, or remove it")
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file, but --out names a folder; name another one")


def write_result(folder: Path, result: dict[str, Any]) -> Path:
    """Write ``result.json`` into `folder`, whole or not at all; never over an existing one. Return its path.

    Raises:
        UsageError: there is a result already, or the folder cannot be written.
    """
    refuse_existing_result(folder)
    path, draft = folder / "result.json", folder / ".result.json.part"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        draft.write_text(as_json(result) + "\n", "utf-8")
        _publish(draft, path)
    except FileExistsError:
        raise UsageError(f"{path} exists already; name another folder with --out, or remove it") from None
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error.strerror}); name another folder with --out") from error
    return path


def write_report(path: Path, result: dict[str, Any]) -> None:
    """Write a result as a page, and say where; raises UsageError when it cannot be written."""
    from atoll.model.saved import write_text
    from atoll.report.page import as_html

    write_text(path, as_html(result))
    note(f"report in {path}")


def _publish(draft: Path, path: Path) -> None:
    """Give `draft` its name in one step; raises FileExistsError rather than replace another file."""
    try:
        path.hardlink_to(draft)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        draft.replace(path)
    else:
        draft.unlink()
