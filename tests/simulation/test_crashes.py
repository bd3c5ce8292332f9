"""What must be whole is whole, at whichever of its commits the coordinator dies."""

import hashlib
from itertools import count

import pytest

from common.config import JobConfig
from common.wire import topics
from common.wire.access import Roster
from common.wire.bus import Query
from common.wire.client_messages import Ask, Submit
from common.wire.codec import encode
from common.wire.simulated_bus import SimulatedNetwork
from coordinator.service.service import Service
from tests.simulation.disk import CoordinatorDied, Disk

TABLE = b"x,y"


@pytest.mark.parametrize("before", [True, False])
def test_a_job_that_is_kept_has_its_submitter(before: bool) -> None:
    ask = encode(Ask(body=Submit(job="j", name="n", config=JobConfig(), table=hashlib.sha256(TABLE).hexdigest())))
    for commits in count(1):
        disk = Disk()
        store = disk.open(lambda seconds: None)
        store.put_blob(TABLE)
        network = SimulatedNetwork(0, None)
        service = Service(network.bus("coordinator", is_router=True), store, roster=Roster({"ann": "submitter"}))
        disk.die_at(commits, before)
        try:
            service._answers.answer(Query(topics.client(store.realm, "ann-1"), ask, None))
            is_over = True
        except CoordinatorDied:
            is_over = False
        disk.forget_death()
        again = disk.open(lambda seconds: None)
        assert again.submitter("j") == ("ann" if again.job("j") is not None else None), commits
        disk.close()
        if is_over:
            assert commits > 1
            return
