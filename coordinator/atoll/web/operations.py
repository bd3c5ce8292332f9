"""Operations of the API. One declaration gives the route of an operation, the validation of requests, and its
description.

`operation` marks a handler with method and path. The types in the handler's signature declare the rest: `query` is a
model of the query parameters, `body` a model of a JSON body, and the result a model of the JSON answer, or a `Response`
that the handler makes itself. `description` writes OpenAPI from the same declarations.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import to_jsonable_python
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

BODY_LIMIT_S: Final = 300.0
"""Time limit for receiving a body, in seconds."""

PATIENCE_S: Final = 20.0
SLOWEST: Final = 32_000
"""A body that arrives at fewer bytes a second for this number of seconds is refused (a poor mobile network)."""

MAX_JSON: Final = 64 * 1024
"""Maximum bytes of a JSON body."""

JSON: Final = "application/json"


class QueryParameters(BaseModel):
    """Query parameters; unknown parameters are ignored."""

    model_config = ConfigDict(frozen=True)


class Body(BaseModel):
    """A JSON body; unknown fields are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


@dataclass(frozen=True)
class Operation:
    """The declaration of a handler. `further` has the schemas of answers with other statuses; None: no body."""

    method: str
    path: str
    status: int = 200
    media: str = JSON
    sent: tuple[str, ...] = ()
    further: Mapping[int, str] = field(default_factory=dict)

    async def call(self, handler: Callable[..., Awaitable[Any]], request: Request) -> Response:
        """Answer a request with the handler; raises HTTPException for an invalid query or body."""
        types, values = get_type_hints(handler), dict[str, BaseModel]()
        if "query" in types:
            fields, sent = types["query"].model_fields, request.query_params
            lists = {name for name, known in fields.items() if get_origin(known.annotation) is list}
            given = {name: sent.getlist(name) if name in lists else sent[name] for name in fields if name in sent}
            values["query"] = _validated(types["query"], given)
        if "body" in types:
            body = bytearray()
            await receive(request, MAX_JSON, body.extend)
            values["body"] = _validated(types["body"], bytes(body))
        answer = await handler(request, **values)
        return answer if isinstance(answer, Response) else JSONResponse(to_jsonable_python(answer), self.status)


def operation(
    method: str, path: str, status: int = 200, media: str = JSON, sent: tuple[str, ...] = (), **further: str
) -> Callable[[Callable[..., Awaitable[Any]]], Callable[..., Awaitable[Any]]]:
    """Mark a handler as an operation.

    Args:
        method: HTTP method.
        path: path below ``/api/v1``, with the names of variable parts in braces.
        status: status of the answer.
        media: media type of the answer.
        sent: media types of a body that is not JSON.
        **further: descriptions of answers with other statuses, by names such as ``_304``.
    """
    others = {int(name[1:]): text for name, text in further.items()}

    def mark(handler: Callable[..., Awaitable[Any]]) -> Callable[..., Awaitable[Any]]:
        handler.operation = Operation(method, path, status, media, sent, others)  # type: ignore[attr-defined]
        return handler

    return mark


def _validated(model: type[BaseModel], values: Any) -> Any:
    try:
        return model.model_validate_json(values) if isinstance(values, bytes) else model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the body"
        is_id = first["type"] == "string_pattern_mismatch"  # only ids have a pattern
        message = "an id has 1 to 64 letters, digits, _ or -" if is_id else first["msg"].removeprefix("Value error, ")
        raise HTTPException(422, f"{where}: {message}") from None


async def receive(request: Request, most: int, take: Callable[[bytes], object]) -> None:
    """Receive a body of at most `most` bytes within the time limits; raises HTTPException."""
    announced = request.headers.get("content-length", "0")
    too_large = HTTPException(413, f"a body may have {most:,} bytes at most; use coordinator submit for larger files")
    if announced.isdecimal() and int(announced) > most:
        raise too_large
    began, received = asyncio.get_running_loop().time(), 0
    try:
        async with asyncio.timeout(PATIENCE_S) as limit:
            async for chunk in request.stream():
                received += len(chunk)
                if received > most:
                    raise too_large
                take(chunk)
                limit.reschedule(began + min(BODY_LIMIT_S, PATIENCE_S + received / SLOWEST))
    except TimeoutError:
        sentence = f"the body arrived too slowly; send {SLOWEST:,} bytes a second, and all in {BODY_LIMIT_S:.0f} s"
        raise HTTPException(408, sentence, {"connection": "close"}) from None
    except ClientDisconnect:
        raise HTTPException(400, "the connection ended before the whole body had arrived") from None
