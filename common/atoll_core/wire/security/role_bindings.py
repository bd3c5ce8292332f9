"""Which principal has which role. Pure but for reading the file, which `--roster` names and users know as the roster.

A principal is the common name of a certificate. It speaks under that name or, with several processes, under names that
begin with it and a hyphen: ``lab1``, ``lab1-0``, ``lab1-gpu-3``. So no two principals may be such that one is the other
with a hyphen and more behind it.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, cast, get_args

from atoll_core.errors import UsageError
from atoll_core.wire.topics import is_id

Role = Literal["coordinator", "router", "worker", "submitter", "admin", "revoked"]
"""``revoked``: a certificate that was lost; a new one gets another name, since routers see names and no numbers."""

MAX_NAME: Final = 48
"""Longest name in a certificate, in characters: those of its processes are this with more behind it."""

MAX_NAMES: Final = 10_000


@dataclass(frozen=True)
class RoleBindings:
    """Roles by principal, as the file has them."""

    roles: Mapping[str, Role] = field(default_factory=dict)

    def principal(self, name: str) -> str | None:
        """Return the principal under which `name` falls: itself, or what stands before one of its hyphens."""
        parts = name.split("-")
        candidates = ("-".join(parts[:count]) for count in range(len(parts), 0, -1))
        return next((candidate for candidate in candidates if candidate in self.roles), None)

    def role(self, name: str) -> Role | None:
        """Return what the principal of `name` may do; None for a stranger."""
        principal = self.principal(name)
        return self.roles[principal] if principal is not None else None


def read_role_bindings(path: Path) -> RoleBindings:
    """Return the role bindings in the TOML file `path`: one line ``name = "role"`` each.

    Raises:
        UsageError: it cannot be read, or a name or role is not as it must be.
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
                f"the roster {source} has {principal} and {name}, but names that begin with {principal}- are those of "
                f"the processes of {principal}; give one of them another name and certificate"
            )
    return role_bindings
