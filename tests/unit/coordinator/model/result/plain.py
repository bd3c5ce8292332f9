"""Parts of a result as they stand in its file."""

import functools
from collections.abc import Callable
from typing import Any

from pydantic import BaseModel

from atoll.text import render
from atoll_coordinator.result.result import Result


def plain(value: Any) -> Any:
    """Return a part, or several, as plain values."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, dict):
        return {name: plain(part) for name, part in value.items()}
    return [plain(part) for part in value] if isinstance(value, list | tuple) else value


def plainly(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function whose value is plain."""

    @functools.wraps(function)
    def called(*arguments: Any, **options: Any) -> Any:
        return plain(function(*arguments, **options))

    return called


def render_text(content: dict[str, Any], *, fronts: bool = False) -> str:
    """Return the text of the content of a result."""
    return render.render_text(Result.of(content), fronts=fronts)


def rendered(content: dict[str, Any], how: str) -> str:
    """Return the content of a result in a format."""
    return render.render(Result.of(content), how)


def pick(content: dict[str, Any], picks: dict[str, int]) -> dict[str, Any]:
    """Return the content of a result with other members of the fronts."""
    return render.pick(Result.of(content), picks).as_dict()
