"""Authorization where certificates prove names: who may take part as what, and who may cancel or delete which job.

The router's access rules drop what they do not allow without an answer. Here a program whose role does not fit is told
so, as the answer to its greeting. Who may end which job cannot be said by rules on keys and is decided here alone.
"""

from typing import Final, Protocol

from atoll_core.wire.messages.clients import Cancel, Delete, Request
from atoll_core.wire.messages.handshake import Hello
from atoll_core.wire.security.role_bindings import Role, RoleBindings

_MAY: Final[dict[Role, str]] = {
    "coordinator": "serve",
    "router": "pass messages on",
    "worker": "compute islands",
    "submitter": "submit jobs and look at them",
    "admin": "submit jobs, look at them, cancel and delete those of others",
}


class Submitters(Protocol):
    """The part of the store that remembers whose job a job is."""

    def submitter(self, job: str) -> str | None: ...


class Authorization:
    """Decides by role bindings; without any (None) everybody may do everything."""

    def __init__(self, role_bindings: RoleBindings | None, submitters: Submitters) -> None:
        self._role_bindings = role_bindings
        self._submitters = submitters

    def refuse_role(self, hello: Hello) -> str | None:
        """Return why a program may not take part as what it says it is; None: it may."""
        if self._role_bindings is None:
            return None
        role = self._role_bindings.role(hello.name)
        if role is None:
            return (
                f"the coordinator's roster has no name for {hello.name!r}; have the name of your certificate written "
                "there, and the coordinator started again"
            )
        fits = role == "worker" if hello.role == "worker" else role != "worker"
        if fits:
            return None
        wanted = "compute islands" if hello.role == "worker" else "submit jobs or look at them"
        return (
            f"the certificate of {self._role_bindings.principal(hello.name)!r} has the role {role}, which may "
            f"{_MAY[role]}, but not {wanted}; use another certificate"
        )

    def refuse_request(self, client: str, request: Request) -> str | None:
        """Return why `client` may not ask this; None: it may."""
        if self._role_bindings is None:
            return None
        role = self._role_bindings.role(client)
        if role not in ("submitter", "admin"):
            return f"{client!r} is not the name of somebody who may submit jobs or look at them"
        if not isinstance(request.body, Cancel | Delete) or role == "admin":
            return None
        owner = self._submitters.submitter(request.body.job)
        if owner in (None, self._role_bindings.principal(client)):
            return None
        return f"job {request.body.job} was submitted by {owner}; only {owner} or an admin may {request.body.kind} it"

    def submitter(self, client: str) -> str | None:
        """Return as whose job one is kept that `client` submits; None: nobody proves who it is."""
        return self._role_bindings.principal(client) if self._role_bindings is not None else None
