"""Roles of principals, read from the roster file, and the access rules that a router derives from them.

A principal is the common name of a certificate. Its processes use that name or names that begin with it and a hyphen:
``lab1``, ``lab1-0``, ``lab1-gpu-3``. Therefore no principal may begin with the name of another principal and a hyphen.
A router denies everything that no rule allows.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, cast, get_args

from atoll_core.errors import UsageError
from atoll_core.wire.topics import HELLO, ROOT, is_id

Role = Literal["coordinator", "router", "worker", "submitter", "admin", "revoked"]
"""``revoked``: a lost certificate; its replacement gets another name, since routers see names and no serial numbers."""

MAX_NAME: Final = 48
"""Longest name in a certificate, in characters; the names of its processes are longer."""

MAX_NAMES: Final = 10_000


@dataclass(frozen=True)
class RoleBindings:
    """Roles by principal."""

    roles: Mapping[str, Role] = field(default_factory=dict)

    def principal(self, name: str) -> str | None:
        """Return the principal of `name`: the name itself, or its part before a hyphen; None for an unknown name."""
        parts = name.split("-")
        candidates = ("-".join(parts[:count]) for count in range(len(parts), 0, -1))
        return next((candidate for candidate in candidates if candidate in self.roles), None)

    def role(self, name: str) -> Role | None:
        """Return the role of the principal of `name`; None for an unknown name."""
        principal = self.principal(name)
        return self.roles[principal] if principal is not None else None


def read_role_bindings(path: Path) -> RoleBindings:
    """Return the role bindings in the TOML file `path`: one line ``name = "role"`` each.

    Raises:
        UsageError: it cannot be read, or a name or role is not allowed.
    """
    try:
        entries = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        reason = (error.strerror or "unknown").lower()
        raise UsageError(
            f"the roster {path} cannot be read ({reason}); make one with deploy/tls/make-authority"
        ) from error
    except ValueError as error:
        raise UsageError(
            f'the roster {path} is not as expected ({error}); each line should be: name = "role"'
        ) from error
    return checked_role_bindings(entries, str(path))


def checked_role_bindings(entries: Mapping[str, object], source: str) -> RoleBindings:
    """Return the role bindings of these entries, read from `source`; raises UsageError."""
    if not 1 <= len(entries) <= MAX_NAMES:
        raise UsageError(f"the roster {source} has {len(entries)} names, but 1 to {MAX_NAMES} were expected")
    for name, role in entries.items():
        if not is_id(name) or len(name) > MAX_NAME:
            raise UsageError(
                f"the roster {source} has the name {name[:80]!r}, but 1 to {MAX_NAME} letters, digits, - and _ were "
                "expected"
            )
        if role not in get_args(Role):
            expected = ", ".join(get_args(Role))
            raise UsageError(f"the roster {source} gives {name} the role {role!r}, but one of {expected} was expected")
    role_bindings = RoleBindings(cast(Mapping[str, Role], dict(entries)))
    for name in role_bindings.roles:
        principal = role_bindings.principal(name.rpartition("-")[0])
        if principal is not None:
            raise UsageError(
                f"the roster {source} has {principal} and {name}, but names that begin with {principal}- belong to "
                f"the processes of {principal}; give one of them another name and certificate"
            )
    return role_bindings


Flow = Literal["ingress", "egress"]

_PUT: Final = ("status", "report", "result", "log")
"""Ends of the keys under its own name on which a worker puts messages."""

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
"""Every program with a certificate may ask whether it would be accepted; that changes nothing."""

_TRUSTED: Final = tuple(Permission(flow, _ALL, (f"{ROOT}/**",)) for flow in get_args(Flow))
"""A coordinator behind the router commands all workers, and another router forwards the messages of its whole site."""


def permissions(name: str, role: Role) -> tuple[Permission, ...]:
    """Return all permissions of the principal `name`; every other message is denied."""
    asked, heard = (
        _keys_of_principal(name, "client/{}/ask") + _hello(name),
        _keys_of_principal(name, "client/{}/changes"),
    )
    match role:
        case "coordinator" | "router":
            return _TRUSTED
        case "revoked":
            return ()
        case "worker":
            heard = _keys("control") + _keys_of_principal(name, "control/{}")
            asked = _keys("job/*/state", "blob/**", "worker/*/pull") + _hello(name)
    pulls = _keys_of_principal(name, "worker/{}/pull")
    of_worker = (
        Permission("ingress", _SPEAKING, _keys_of_principal(name, *(f"worker/{{}}/{part}" for part in _PUT))),
        Permission("ingress", _PRESENCE, _keys_of_principal(name, "worker/{}/alive")),
        Permission("ingress", _SERVING, pulls),
        Permission("egress", ("query",), pulls),
    )
    return (
        *(of_worker if role == "worker" else ()),
        Permission("ingress", ("declare_subscriber",), heard),
        Permission("egress", _SPEAKING, heard),
        Permission("ingress", ("query",), asked),
        Permission("egress", _SERVING, asked),
    )


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


def _keys(*parts: str) -> tuple[str, ...]:
    return tuple(f"{ROOT}/*/{part}" for part in parts)


def _keys_of_principal(name: str, *parts: str) -> tuple[str, ...]:
    """Return keys with the name, and with the names of its processes, in place of ``{}``."""
    return _keys(*(part.format(form) for part in parts for form in (name, f"{name}-$*")))


def _hello(name: str) -> tuple[str, ...]:
    return (f"{HELLO}/{name}", f"{HELLO}/{name}-$*")
