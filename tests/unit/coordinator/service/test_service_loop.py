"""The service's loop tells the bus who asks: a user, without certificates a session."""

import pytest

from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Posted, Query
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.clients import ClientRequest, ListJobs
from atoll_core.wire.security.roles import RoleBindings
from tests.simulation.bus.network import SimulatedNetwork

ROLES = RoleBindings({"ann": "submitter", "bob": "submitter"})


@pytest.mark.parametrize(
    ("roles", "parties"), [(ROLES, ["ann", "ann", "bob"]), (None, ["/s1", "/s2", "/s1"])], ids=["roles", "none"]
)
def test_an_answer_belongs_to_the_user_who_asked_or_to_the_session(
    roles: RoleBindings | None, parties: list[str]
) -> None:
    with Store.open(None) as store:
        bus = SimulatedNetwork().bus("coordinator", is_router=True)
        answered, posted = list[str | None](), list[object]()
        bus.reply = lambda query, payload, party=None: answered.append(party)  # type: ignore[method-assign]
        bus.post = posted.append  # type: ignore[method-assign]
        service = Service(bus, store, role_bindings=roles)
        for client, session in (("ann-1", "s1"), ("ann-2", "s2"), ("bob-1", "s1")):
            key = topics.client(store.cluster, client)
            service.step(Query(key, encode(ClientRequest(body=ListJobs())), None, session))
            while posted:
                service.step(Posted(posted.pop(0)))
        assert answered == parties
