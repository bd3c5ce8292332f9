"""The API's description as OpenAPI 3.1 has it, made of the routes, their docstrings and the models of the messages.

``python -m atoll.web.description`` writes ``openapi.json``; a test compares the two.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel
from starlette.routing import Route

from atoll.client.over_http import MESSAGE
from atoll.web.api import BODIES, Api
from atoll.web.reading import TABLE, Readers
from atoll_core import VERSION
from atoll_core.wire.messages.clients import QueueDepth
from atoll_core.wire.messages.limits import MAX_PAGE_JOBS
from atoll_core.wire.messages.views import CoordinatorView, EventView, IslandView, JobView, WorkerView

_TEXT: Final[dict[str, Any]] = {"type": "string"}
_FLAG: Final[dict[str, Any]] = {"type": "boolean"}
_ID: Final[dict[str, Any]] = {"type": "string", "pattern": "^[A-Za-z0-9_-]{1,64}$"}
_SIZES: Final[dict[str, Any]] = {"type": "array", "items": {"type": "integer", "minimum": 0}}
_NAMES: Final[dict[str, Any]] = {"type": "array", "items": _TEXT}
_OBJECT: Final[dict[str, Any]] = {"type": "object"}

_PICK: Final[tuple[Mapping[str, Any], str]] = (_NAMES, "other equations: VARIABLE=NUMBER of its front, from 0")
_OPTIONS: Final = "options of the command line by name, as a JSON object: texts, true, or lists of texts"
_FILE: Final[Mapping[str, tuple[Mapping[str, Any], str]]] = {
    "filename": (_NAMES, "the name that the file has; its ending says how it is read. Several files are one table"),
    "bytes": (_SIZES, "of each of several files, which are one after the other in the body"),
    "options": (_TEXT, _OPTIONS),
    "of": (_ID, "a job whose data are taken in the place of a body"),
}

_EVENTS: Final[Mapping[str, tuple[Mapping[str, Any], str]]] = {
    "after": ({"type": "integer", "minimum": 0}, "the number of an event"),
    "limit": ({"type": "integer", "minimum": 1, "maximum": 1000}, "events at most"),
    "of_workers": (_FLAG, "only what workers have logged"),
}

QUERIES: Final[Mapping[str, Mapping[str, tuple[Mapping[str, Any], str]]]] = {
    "jobs": {
        "limit": ({"type": "integer", "minimum": 1, "maximum": MAX_PAGE_JOBS}, "jobs at most"),
        "cursor": ({"type": "integer", "minimum": 0}, "`next` of the page before"),
        "prefix": (_TEXT, "the beginning of their ids"),
        "state": ({"type": "string"}, "only those in this state"),
    },
    "submit": {
        **_FILE,
        "id": (_ID, "the job's id: the same id with the same contents is the same job"),
        "name": (_TEXT, "a label for lists"),
        "priority": ({"type": "integer", "minimum": -10, "maximum": 10}, "among one's own jobs"),
        "shared": (_FLAG, "let everybody see the job"),
    },
    "outline": _FILE,
    "preview": _FILE,
    "retry": {"id": (_ID, "the new job's id")},
    "logs": _EVENTS,
    "all_logs": _EVENTS,
    "events": {
        "jobs": ({"type": "array", "items": _TEXT, "maxItems": 32}, "ids, or all"),
        "after": ({"type": "integer", "minimum": 0}, "as the header Last-Event-ID"),
    },
    "result": {"download": (_FLAG, "as a file")},
    "export": {"download": (_FLAG, "as a file"), "pick": _PICK},
    "simulation": {"pick": _PICK},
    "workers": {"prefix": (_TEXT, "the beginning of their names")},
}
"""What is asked in the query, by handler."""

_STATUS: Final[Mapping[str, int]] = {"submit": 201, "retry": 201, "delete": 204}


def _of(model: type[BaseModel]) -> dict[str, Any]:
    return {"$ref": f"#/components/schemas/{model.__name__}"}


def _list(name: str, model: type[BaseModel], **further: Any) -> dict[str, Any]:
    """Return the schema of an object that holds a list."""
    properties = {name: {"type": "array", "items": _of(model)}, **further}
    return {"type": "object", "required": [*properties], "properties": properties}


_ANSWERS: Final[Mapping[str, Any]] = {
    "jobs": _list("jobs", JobView, next={"type": ["integer", "null"]}),
    "logs": _list("events", EventView),
    "all_logs": _list("events", EventView),
    "islands": _list("islands", IslandView),
    "workers": _list("workers", WorkerView),
    "set_service": _list("workers", WorkerView),
}
"""Schemas of answers by handler; others are objects."""

_VIEWS: Final = ("job", "submit", "cancel", "pause", "resume", "retry", "set_priority", "set_sharing")

_MEDIA: Final[Mapping[str, str]] = {
    "events": "text/event-stream", "report": "text/html", "export": "text/plain", "metrics": "text/plain",
    "messages": MESSAGE,
}  # fmt: skip

MODELS: Final[tuple[type[BaseModel], ...]] = (JobView, EventView, WorkerView, IslandView, CoordinatorView, QueueDepth)


def describe() -> dict[str, Any]:
    """Return the description."""
    schemas: dict[str, Any] = {}
    for model in (*MODELS, *BODIES.values()):
        schema = model.model_json_schema(ref_template="#/components/schemas/{model}", mode="serialization")
        schemas |= schema.pop("$defs", {})
        schemas[model.__name__] = schema
    schemas["Problem"] = {
        "type": "object",
        "required": ["type", "title", "status", "detail"],
        "properties": {
            "type": _TEXT,
            "title": _TEXT,
            "status": {"type": "integer"},
            "detail": _TEXT,
            "columns": {
                "description": "of a file that was refused: its columns, for options that name one",
                "type": "array",
                "items": {"type": "object"},
            },
        },
    }
    paths: dict[str, dict[str, Any]] = {}
    for route in Api(Readers()).routes():
        assert isinstance(route, Route)
        method = next(iter((route.methods or set()) - {"HEAD"})).lower()
        paths.setdefault(route.path, {})[method] = _operation(route)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "Atoll",
            "version": VERSION,
            "description": "Jobs, results and workers of a coordinator. What changes something needs a token.",
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


def _operation(route: Route) -> dict[str, Any]:
    name = route.endpoint.__name__
    names = [part[1:-1] for part in route.path.split("/") if part.startswith("{")]
    parameters: list[dict[str, Any]] = [
        {"name": part, "in": "path", "required": True, "schema": _ID if part != "format" else _TEXT} for part in names
    ]
    parameters += [
        {"name": part, "in": "query", "schema": dict(schema), "description": text}
        for part, (schema, text) in QUERIES.get(name, {}).items()
    ]
    if name == "events":
        parameters.append({"name": "Last-Event-ID", "in": "header", "schema": {"type": "integer", "minimum": 0}})
    operation: dict[str, Any] = {"operationId": name, "summary": (route.endpoint.__doc__ or "").strip()}
    if parameters:
        operation["parameters"] = parameters
    if name in BODIES:
        content = {"application/json": {"schema": _of(BODIES[name])}}
        operation["requestBody"] = {"required": True, "content": content}
    elif name == "messages":
        operation["requestBody"] = {"required": True, "content": {MESSAGE: {}}}
    elif QUERIES.get(name, {}).get("filename"):
        kinds: dict[str, Any] = {"application/octet-stream": {}, "text/csv": {}, TABLE: {}}
        operation["requestBody"] = {"required": True, "content": kinds}
    return operation | {"responses": _responses(name, names)}


def _responses(name: str, path: list[str]) -> dict[str, Any]:
    problem = {"content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}}
    status = _STATUS.get(name, 200)
    media = _MEDIA.get(name, "application/json")
    done: dict[str, Any] = {"description": "done"}
    if status != 204:
        schema = (
            _ANSWERS.get(name, _of(JobView) if name in _VIEWS else _OBJECT) if media == "application/json" else _TEXT
        )
        done["content"] = {media: {"schema": schema}}
    answers = {str(status): done}
    if name == "report":
        answers["202"] = {"description": "a worker makes it", "content": {"application/json": {"schema": _OBJECT}}}
    if name == "progress":
        answers["304"] = {"description": "it has not changed"}
    if name == "health":
        answers["503"] = {"description": "no answer", "content": {"application/json": {"schema": _OBJECT}}}
    return answers | {"default": {"description": "a sentence says what is wrong", **problem}}


def to_text() -> str:
    """Return the description as the file has it."""
    return json.dumps(describe(), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    (Path(__file__).parent / "openapi.json").write_text(to_text(), "utf-8")
