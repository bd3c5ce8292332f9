"""Authorization by certificates: which program may have which role, and which user may see and change which jobs.

The router's access rules drop forbidden messages without an answer. Here a program whose role does not fit gets a
sentence, as the answer to its greeting. The router's rules are about keys, and cannot tell to whom a job belongs. Only
this module decides that: a job is visible to its submitter and to admins, and if it is shared, to all users. For other
users the job does not exist.
"""

from typing import Final, Protocol

from atoll_coordinator.service.store.jobs import Viewer
from atoll_core.wire.messages import clients as messages
from atoll_core.wire.messages.handshake import Hello
from atoll_core.wire.security.roles import Role, RoleBindings

_MAY: Final[dict[Role, str]] = {
    "coordinator": "serve",
    "router": "pass messages on",
    "worker": "compute islands",
    "submitter": "submit jobs and look at its own and shared ones",
    "admin": "submit jobs, and look at, change and end jobs of others",
}

_CHANGES: Final[dict[type, str]] = {
    messages.Cancel: "cancel", messages.Delete: "delete", messages.Pause: "pause or resume",
    messages.SetPriority: "change the priority of", messages.Share: "share", messages.Retry: "retry",
}  # fmt: skip
_OF_SERVICE: Final = (messages.SetWorker, messages.SetQueue)


class Jobs(Protocol):
    """The part of the store that has the submitters of jobs."""

    def submitter(self, job: str) -> str | None: ...

    def is_seen(self, job: str, viewer: Viewer) -> bool: ...


class Authorization:
    """Decides by role bindings; without bindings (None) every client has all permissions."""

    def __init__(self, role_bindings: RoleBindings | None, jobs: Jobs) -> None:
        """`role_bindings` may be replaced at any time; a router has the new ones only after a restart."""
        self.role_bindings = role_bindings
        self._jobs = jobs

    def refuse_role(self, hello: Hello) -> str | None:
        """Return why a program may not take part in its role; None: it may."""
        if self.role_bindings is None:
            return None
        role = self.role_bindings.role(hello.name)
        if role is None:
            return (
                f"the coordinator's roster has no entry for {hello.name!r}; ask an admin to add the name of your "
                "certificate, and to let the coordinator read the roster again (SIGHUP)"
            )
        if role == "revoked":
            return self._revoked(hello.name)
        fits = role == "worker" if hello.role == "worker" else role != "worker"
        if fits:
            return None
        wanted = "compute islands" if hello.role == "worker" else "submit jobs or look at them"
        return (
            f"the certificate of {self.role_bindings.principal(hello.name)!r} has the role {role}, which may "
            f"{_MAY[role]}, but not {wanted}; use another certificate"
        )

    def refuse_worker(self, name: str) -> str | None:
        """Return why a worker may no longer take part; None: it may."""
        if self.role_bindings is None or self.role_bindings.role(name) == "worker":
            return None
        if self.role_bindings.role(name) == "revoked":
            return self._revoked(name)
        return f"the coordinator's roster no longer lists {name!r} as a worker"

    def refuse_request(self, client: str, request: messages.ClientRequest) -> str | None:
        """Return why `client` may not send a request; None: it may. Check `hides` first, so that jobs stay secret."""
        if self.role_bindings is None:
            return None
        role, body = self.role_bindings.role(client), request.body
        if role == "revoked":
            return self._revoked(client)
        if role not in ("submitter", "admin"):
            return f"{client!r} is not the name of a user who may submit jobs or look at them"
        if role == "admin":
            return None
        if isinstance(body, _OF_SERVICE):
            return "only an admin may change workers or the queue"
        if not isinstance(
            body,
            messages.Cancel | messages.Delete | messages.Pause | messages.SetPriority | messages.Share | messages.Retry,
        ):
            return None
        owner = self._jobs.submitter(body.job)
        if owner is None:  # a job without a submitter belongs to no user
            return (
                f"job {body.job} was submitted before there was a roster; only an admin may {_CHANGES[type(body)]} it"
            )
        if owner == self.role_bindings.principal(client):
            return None
        may = f"only {owner} or an admin may {_CHANGES[type(body)]} it"
        return f"job {body.job} was submitted by {owner}; {may}"

    def hides(self, client: str, request: messages.ClientRequest) -> str | None:
        """Return the id of the job in a request that `client` may not see; None: there is none."""
        viewer, job = self.viewer(client), getattr(request.body, "job", None)
        if viewer is None or job is None or isinstance(request.body, messages.Submit):
            return None
        return None if self._jobs.is_seen(job, viewer) else str(job)

    def viewer(self, client: str) -> Viewer | None:
        """Return the viewer for a client; None: it sees all jobs."""
        if self.role_bindings is None or self.role_bindings.role(client) == "admin":
            return None
        return Viewer(self.role_bindings.principal(client))

    def may_follow(self, client: str, job: str | None, viewer: Viewer | None) -> bool:
        """Return whether `client` may follow a job, or all events (None) that `viewer` sees."""
        if self.refuse_request(client, messages.ClientRequest(body=messages.Follow(job=job))) is not None:
            return False
        own = self.viewer(client)
        return own == viewer if job is None else own is None or self._jobs.is_seen(job, own)

    def submitter(self, client: str) -> str | None:
        """Return the submitter of jobs from `client`; None: there are no certificates."""
        return self.role_bindings.principal(client) if self.role_bindings is not None else None

    def _revoked(self, name: str) -> str:
        principal = self.role_bindings.principal(name) if self.role_bindings is not None else None
        return f"the certificate of {principal!r} is revoked; ask for a certificate with another name"
