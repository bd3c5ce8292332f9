"""What each role may say on the bus, and the access rules that a router makes of role bindings.

Everything is denied that no rule allows.
"""

from dataclasses import dataclass
from typing import Final, Literal, get_args

from atoll_core.wire.security.role_bindings import Role, RoleBindings
from atoll_core.wire.topics import HELLO, ROOT

Flow = Literal["ingress", "egress"]

_PUT: Final = ("status", "report", "result", "log", "to/*")
"""What a worker puts under its own names."""

_ANYBODY: Final = "(anybody)"
_SPEAKING: Final = ("put",)
_SERVING: Final = ("declare_queryable", "reply")
_PRESENCE: Final = ("liveliness_token",)
_ALL: Final = (
    *("put", "delete", "query", "reply", "declare_subscriber", "declare_queryable"),
    *("liveliness_token", "liveliness_query", "declare_liveliness_subscriber"),
)


@dataclass(frozen=True, slots=True)
class Permission:
    """Messages of these kinds may pass on these keys: `ingress` from the principal, `egress` towards it."""

    flow: Flow
    messages: tuple[str, ...]
    keys: tuple[str, ...]


_OF_ANYBODY: Final = (Permission("ingress", ("query",), (HELLO,)), Permission("egress", _SERVING, (HELLO,)))
"""Whoever has a certificate may ask whether there is a place for its name; that changes nothing."""

_TRUSTED: Final = tuple(Permission(flow, _ALL, (f"{ROOT}/**",)) for flow in get_args(Flow))
"""A coordinator beyond the router commands all others, and another router passes on what all of its site say."""


def permissions(name: str, role: Role) -> tuple[Permission, ...]:
    """Return what the principal `name` may send and receive; everything else is denied."""
    if role in ("coordinator", "router"):
        return _TRUSTED
    if role == "revoked":
        return ()
    if role == "worker":
        return _of_worker(name)
    return _of_client(name)


def access_control(role_bindings: RoleBindings) -> dict[str, object]:
    """Return the router's setting ``access_control``: a rule set and a subject for each name, all else denied."""
    granted = {name: permissions(name, role) for name, role in role_bindings.roles.items() if role != "revoked"}
    granted[_ANYBODY] = _OF_ANYBODY
    rules = [
        {
            "id": f"{name}/{number}",
            "permission": "allow",
            "flows": [permission.flow],
            "messages": list(permission.messages),
            "key_exprs": list(permission.keys),
        }
        for name, allowed in granted.items()
        for number, permission in enumerate(allowed)
    ]
    subjects: list[dict[str, object]] = [
        {"id": name, "cert_common_names": [name]} for name in granted if name != _ANYBODY
    ]
    subjects.append({"id": _ANYBODY})  # without any condition
    policies = [
        {"rules": [f"{name}/{number}" for number in range(len(allowed))], "subjects": [name]}
        for name, allowed in granted.items()
    ]
    return {"enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies}


def _of_worker(name: str) -> tuple[Permission, ...]:
    heard = _keys("control") + _own(name, "control/{}", "worker/*/to/{}")
    pulls = _own(name, "worker/{}/pull")
    asked = _keys("job/**", "blob/**", "worker/*/pull") + _hello(name)
    return (
        Permission("ingress", _SPEAKING, _own(name, *(f"worker/{{}}/{part}" for part in _PUT))),
        Permission("ingress", _PRESENCE, _own(name, "worker/{}/alive")),
        Permission("ingress", _SERVING, pulls),
        Permission("egress", ("query",), pulls),
        Permission("ingress", ("declare_subscriber",), heard),
        Permission("egress", _SPEAKING, heard),
        Permission("ingress", ("query",), asked),
        Permission("egress", _SERVING, asked),
    )


def _of_client(name: str) -> tuple[Permission, ...]:
    asked, heard = _own(name, "client/{}/ask") + _hello(name), _own(name, "client/{}/changes")
    return (
        Permission("ingress", ("query",), asked),
        Permission("egress", _SERVING, asked),
        Permission("ingress", ("declare_subscriber",), heard),
        Permission("egress", _SPEAKING, heard),
    )


def _keys(*parts: str) -> tuple[str, ...]:
    return tuple(f"{ROOT}/*/{part}" for part in parts)


def _own(name: str, *parts: str) -> tuple[str, ...]:
    """Return keys with the name, and with those of its processes, in place of ``{}``."""
    return _keys(*(part.format(form) for part in parts for form in (name, f"{name}-$*")))


def _hello(name: str) -> tuple[str, ...]:
    return (f"{HELLO}/{name}", f"{HELLO}/{name}-$*")
