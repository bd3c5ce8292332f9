"""Errors of the API as problem details (RFC 9457), with the sentences of the command line."""

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Final

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from atoll.web.gateway import BusyError
from atoll_core.errors import AtollError, DataError, RefusedError, UnknownJobError, UnreachableError, UsageError

_STATUS: Final[Mapping[type[AtollError], int]] = {
    UnreachableError: 503, DataError: 422, UsageError: 422, UnknownJobError: 404, RefusedError: 409,
}  # fmt: skip


class ProblemDetails(JSONResponse):
    """An error as the answer to a request (RFC 9457)."""

    media_type = "application/problem+json"

    def __init__(self, status: int, detail: str, headers: Mapping[str, str] | None = None, **members: object) -> None:
        content = {"type": "about:blank", "title": HTTPStatus(status).phrase, "status": status, "detail": detail}
        super().__init__(content | members, status, headers)


class UnreadableError(HTTPException):
    """Raised when a file is refused; `columns` has the columns of its table, empty if it could not be read at all."""

    def __init__(self, status_code: int, detail: str, columns: Sequence[Mapping[str, object]] = ()) -> None:
        super().__init__(status_code, detail)
        self.columns = columns


def status_of(error: AtollError) -> int:
    """Return the HTTP status for an error."""
    return next((status for kind, status in _STATUS.items() if isinstance(error, kind)), 500)


def problem_of(request: Request, error: Exception) -> Response:
    """Return the answer to a request that raised an error; the application's handler of all exceptions."""
    if isinstance(error, HTTPException):
        members = {"columns": list(error.columns)} if isinstance(error, UnreadableError) and error.columns else {}
        return ProblemDetails(error.status_code, error.detail, error.headers, **members)
    if isinstance(error, AtollError):
        status = status_of(error)
        return ProblemDetails(status, str(error), {"retry-after": "1"} if status == 503 else None)
    assert isinstance(error, BusyError)
    return ProblemDetails(
        503, "too many requests are waiting; send this request again in a second", {"retry-after": "1"}
    )
