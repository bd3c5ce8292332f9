"""Builds the API's description in OpenAPI 3.1 from the declared operations and their models.

``python -m atoll.web.description`` writes ``openapi.json``; a test compares the two.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, get_type_hints

from pydantic import BaseModel
from starlette.responses import Response

from atoll.web.api import Api
from atoll.web.operations import JSON, Operation
from atoll.web.reading import Readers
from atoll_core import VERSION
from atoll_core.wire.messages.views import JobView

_TEXT: Final[dict[str, Any]] = {"type": "string"}
_ID: Final[dict[str, Any]] = {"type": "string", "pattern": "^[A-Za-z0-9_-]{1,64}$"}
_OBJECT: Final[dict[str, Any]] = {"type": "object"}
_REF: Final = "#/components/schemas/{model}"
_PROBLEM: Final[dict[str, Any]] = {
    "type": "object",
    "required": ["type", "title", "status", "detail"],
    "properties": {
        "type": _TEXT, "title": _TEXT, "status": {"type": "integer"}, "detail": _TEXT,
        "columns": {
            "description": "columns of a refused file, for options that name a column",
            "type": "array",
            "items": {"type": "object"},
        },
    },
}  # fmt: skip


def describe() -> dict[str, Any]:
    """Return the description."""
    schemas: dict[str, Any] = {"Problem": _PROBLEM}
    paths: dict[str, dict[str, Any]] = {}
    for declared, handler in Api(Readers()).operations():
        paths.setdefault(declared.path, {})[declared.method.lower()] = _described(declared, handler, schemas)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "Atoll",
            "version": VERSION,
            "description": "Jobs, results and workers of a coordinator. Operations that change something need a token.",
            "license": {"name": "Apache-2.0", "identifier": "Apache-2.0"},
        },
        "servers": [{"url": "/api/v1"}],
        "security": [{}, {"token": []}],
        "paths": paths,
        "components": {
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
            "schemas": dict(sorted(schemas.items())),
        },
    }


def _described(declared: Operation, handler: Callable[..., Any], schemas: dict[str, Any]) -> dict[str, Any]:
    types = get_type_hints(handler)
    parameters: list[dict[str, Any]] = [
        {"name": name, "in": "path", "required": True, "schema": _ID if name != "format" else _TEXT}
        for name in re.findall("{([a-z]+)}", declared.path)
    ]
    if "query" in types:
        for name, schema in types["query"].model_json_schema()["properties"].items():
            text = schema.pop("description")
            parameters.append({"name": name, "in": "query", "schema": _plain(schema), "description": text})
    if declared.media == "text/event-stream":
        parameters.append({"name": "Last-Event-ID", "in": "header", "schema": {"type": "integer", "minimum": 0}})
    described: dict[str, Any] = {"operationId": handler.__name__, "summary": (handler.__doc__ or "").strip()}
    if parameters:
        described["parameters"] = parameters
    if "body" in types:
        described["requestBody"] = {"required": True, "content": {JSON: {"schema": _schema(types["body"], schemas)}}}
    elif declared.sent:
        described["requestBody"] = {"required": True, "content": {media: {} for media in declared.sent}}
    return described | {"responses": _responses(declared, types["return"], schemas)}


def _responses(declared: Operation, answer: Any, schemas: dict[str, Any]) -> dict[str, Any]:
    done: dict[str, Any] = {"description": "done"}
    if declared.status == 201:
        answer = JobView
    if declared.status != 204:
        schema = _schema(answer, schemas) if declared.media == JSON else _TEXT
        done["content"] = {declared.media: {"schema": schema}}
    responses: dict[str, Any] = {str(declared.status): done}
    for status, text in declared.further.items():
        content = {} if status == 304 else {"content": {JSON: {"schema": _OBJECT}}}
        responses[str(status)] = {"description": text, **content}
    problem = {"application/problem+json": {"schema": {"$ref": _REF.format(model="Problem")}}}
    return responses | {"default": {"description": "a sentence on the error", "content": problem}}


def _schema(model: Any, schemas: dict[str, Any]) -> dict[str, Any]:
    """Return a reference to the schema of a model, and add the schema to `schemas`; other types become objects."""
    if not (isinstance(model, type) and issubclass(model, BaseModel)) or issubclass(model, Response):
        return _OBJECT
    schema = model.model_json_schema(ref_template=_REF, mode="serialization")
    schemas |= schema.pop("$defs", {})
    schemas[model.__name__] = schema
    return {"$ref": _REF.format(model=model.__name__)}


def _plain(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a query parameter without null, because a parameter without a value is left out."""
    (*_, given) = ({}, *(one for one in schema.get("anyOf", [schema]) if one.get("type") != "null"))
    return {name: value for name, value in given.items() if name not in ("title", "default")}


def to_text() -> str:
    """Return the description as the text of ``openapi.json``."""
    return json.dumps(describe(), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    (Path(__file__).parent / "openapi.json").write_text(to_text(), "utf-8")
