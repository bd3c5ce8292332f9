"""Litestream's file names the store of the unit, under the name that the store has."""

import yaml

from atoll_coordinator.service.store.schema import FILE_NAME
from tests.unit.documents import ROOT


def test_it_copies_the_store_of_the_unit() -> None:
    text = (ROOT / "deploy" / "litestream" / "litestream.yml").read_text("utf-8")
    (database,) = yaml.safe_load(text)["dbs"]
    unit = (ROOT / "deploy" / "systemd" / "atoll-coordinator.service").read_text("utf-8")
    state = unit.partition("--state ")[2].split()[0]
    assert database["path"] == f"{state}/{FILE_NAME}"
    assert len(database["replicas"]) == 1
    assert not database["replicas"][0]["path"].startswith(state), "a copy on the disk that is lost is none"
    assert f"restore copy.sqlite3 --state {state}" in text
