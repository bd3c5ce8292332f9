"""Units of systemd, compose files beside the main one, the settings of an external router."""

import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from atoll.cli import parser as arguments
from atoll_core.wire.addresses import bindable, parse_address
from atoll_core.wire.bus.zenoh_bus import open_client
from atoll_island_worker import cli as worker_cli
from tests.unit.documents import ROOT

UNITS = ROOT / "deploy" / "systemd"
COMPOSE = ROOT / "deploy" / "compose"


def words(unit: str) -> list[str]:
    """Return the command of a unit, variables replaced by an address."""
    text = (UNITS / unit).read_text("utf-8")
    (line,) = re.findall(r"^ExecStart=(.*)$", text, re.MULTILINE)
    return shlex.split(re.sub(r"\$\{\w+\}", "tcp/0.0.0.0:7447", line))


def test_units_start_the_programs_with_options_that_they_have() -> None:
    assert arguments.parse(words("atoll-coordinator.service")[1:]).verb == "serve"
    page = arguments.parse(shlex.split(shlex.join(words("atoll-web.service")[1:]).replace("tcp/0.0.0.0", "127.0.0.1")))
    assert (page.verb, page.listen) == ("web", ("127.0.0.1", 7447))
    assert worker_cli._parse(words("atoll-island-worker@.service")[1:]).wait > 3600


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
@pytest.mark.parametrize(
    ("unit", "instance"),
    [
        ("atoll-coordinator.service",) * 2,
        ("atoll-web.service",) * 2,
        ("atoll-island-worker@.service", "atoll-island-worker@lab.service"),
    ],
)
def test_units_are_what_systemd_understands(unit: str, instance: str, tmp_path: Path) -> None:
    text = (UNITS / unit).read_text("utf-8")
    (tmp_path / unit).write_text(re.sub(r"/opt/atoll/bin/\S+", "/bin/true", text))
    done = subprocess.run(
        ["systemd-analyze", "verify", str(tmp_path / instance)],
        capture_output=True, text=True, timeout=60, check=False, env={**os.environ, "SYSTEMD_LOG_LEVEL": "warning"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert str(tmp_path) not in done.stderr, done.stderr


def compose(name: str) -> dict[str, Any]:
    text = (COMPOSE / name).read_text("utf-8")
    text = re.sub(r"\$\{\w+:\?[^}]*\}", "tcp/10.0.0.1:7447", re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", text))
    return dict(yaml.safe_load(text))


def test_the_override_with_certificates_changes_services_that_there_are() -> None:
    base = yaml.safe_load((ROOT / "docker-compose.yml").read_text("utf-8"))
    override = compose("tls.yml")
    assert set(override["services"]) == set(base["services"])
    options = arguments.parse(override["services"]["coordinator"]["command"][1:])
    assert parse_address(options.listen).protocol == "tls"
    for service in override["services"].values():
        assert parse_address(service["environment"]["ATOLL_CONNECT"]).protocol == "tls"
        mounted = {volume.rpartition(":")[0].rpartition(":")[2] for volume in service["volumes"]}
        for name in ("CA", "CERT", "KEY"):
            assert str(Path(service["environment"][f"ATOLL_TLS_{name}"]).parent) in mounted
    assert options.roster == "/tls/roster.toml"
    assert all(volume.endswith(":ro") for service in override["services"].values() for volume in service["volumes"])


def test_a_sites_workers_dial_its_router_which_dials_the_coordinator() -> None:
    services = compose("site.yml")["services"]
    options = arguments.parse(services["router"]["command"][1:])
    assert options.verb == "router"
    assert options.connect == ["tcp/10.0.0.1:7447"]
    address = parse_address(services["worker"]["environment"]["ATOLL_CONNECT"])
    assert (address.host, address.port) == ("router", parse_address(options.listen).port)
    build = services["router"]["build"]
    assert (COMPOSE / build["context"] / build["dockerfile"]).resolve() == ROOT / "deploy" / "Dockerfile"


def test_the_settings_for_zenohd_are_those_of_our_own_router() -> None:
    """They are read by zenoh itself, and a router with them passes messages on."""
    import zenoh

    from atoll_core.wire.bus import zenoh_bus

    theirs = zenoh.Config.from_file(str(ROOT / "deploy" / "router" / "zenohd.json5"))
    ours = zenoh_bus._config("router", ["tcp/0.0.0.0:7447"], [], {})
    for place in (
        "mode", "listen/endpoints", "scouting", "transport/shared_memory", "transport/unicast",
        "transport/link/tx", "transport/link/rx",
    ):  # fmt: skip
        assert theirs.get_json(place) == ours.get_json(place), place
    address = str(bindable(parse_address("tcp/127.0.0.1:0")))
    theirs.insert_json5("listen/endpoints", f'["{address}"]')
    with zenoh.open(theirs), open_client(address, 10.0) as client:
        assert client.endpoint == address
