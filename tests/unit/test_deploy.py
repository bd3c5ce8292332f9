"""Image and compose file, as far as they can be judged without a container engine: syntax, and fit with programs."""

import ast
import fnmatch
import pkgutil
import re
import shlex
from argparse import Namespace
from pathlib import Path
from typing import Any

import pytest
import yaml

from atoll.cli import parser as arguments
from atoll_core.compilation.cache import cache_directory
from atoll_core.wire.addresses import Address, parse_address
from atoll_island_worker import cli as worker_cli
from tests.unit.documents import PROGRAMS, ROOT

Instruction = tuple[str, str]


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    return dict(yaml.safe_load((ROOT / "docker-compose.yml").read_text("utf-8")))


@pytest.fixture(scope="module")
def image() -> list[Instruction]:
    """Return the instructions of the Dockerfile with their arguments, continued lines joined."""
    lines = (ROOT / "deploy" / "Dockerfile").read_text("utf-8").splitlines()
    text = "\n".join(line for line in lines if not line.lstrip().startswith("#"))
    joined = re.sub(r"\\\n\s*", "", text)
    pairs = [line.split(maxsplit=1) for line in joined.splitlines() if line.strip()]
    return [(name, rest) for name, rest in pairs]


@pytest.fixture(scope="module")
def final(image: list[Instruction]) -> list[Instruction]:
    """Return the instructions of the last stage, which make the image."""
    last = max(place for place, (name, _) in enumerate(image) if name == "FROM")
    return image[last:]


def of(image: list[Instruction], name: str) -> list[str]:
    return [rest for instruction, rest in image if instruction == name]


def environment(image: list[Instruction]) -> dict[str, str]:
    return dict(word.split("=", 1) for rest in of(image, "ENV") for word in shlex.split(rest))


def interpolated(text: str) -> str:
    """Put in the defaults of ``${NAME:-default}``."""
    return re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", text)


def parsed(command: list[str]) -> Namespace:
    """Return the options of a command as its program reads them; raises UsageError."""
    assert command[0] in PROGRAMS
    return arguments.parse(command[1:]) if command[0] == "coordinator" else worker_cli._parse(command[1:])


def listen(compose: dict[str, Any]) -> Address:
    return parse_address(parsed(compose["services"]["coordinator"]["command"]).listen)


def test_compose_starts_a_coordinator_that_others_can_reach(compose: dict[str, Any]) -> None:
    options = parsed(compose["services"]["coordinator"]["command"])
    assert options.verb == "serve"
    assert listen(compose).host == "0.0.0.0"
    (published,) = compose["services"]["coordinator"]["ports"]
    host, outside, inside = interpolated(published).split(":")
    assert host == "127.0.0.1", "whoever reaches the port can use it, so that it is opened on request only"
    assert int(outside) == int(inside) == listen(compose).port


def test_compose_asks_the_coordinator_whether_it_answers(compose: dict[str, Any]) -> None:
    mark, *command = compose["services"]["coordinator"]["healthcheck"]["test"]
    assert mark == "CMD"
    assert parsed(command).verb == "ping"
    assert compose["services"]["worker"]["depends_on"] == {"coordinator": {"condition": "service_healthy"}}


def test_compose_workers_dial_the_coordinator_and_are_one_process_each(compose: dict[str, Any]) -> None:
    worker = compose["services"]["worker"]
    address = parse_address(worker["environment"]["ATOLL_CONNECT"])
    assert address == Address("tcp", "coordinator", listen(compose).port)
    options = parsed(worker["command"])
    assert options.processes == 1, "--scale says how many"
    assert "container_name" not in worker, "a name could be given to one container only"
    assert "ports" not in worker


def test_compose_keeps_the_state_in_a_named_volume(compose: dict[str, Any]) -> None:
    mounts = dict(volume.split(":") for volume in compose["services"]["coordinator"]["volumes"])
    assert set(mounts) == set(compose["volumes"])
    assert mounts["state"] == parsed(compose["services"]["coordinator"]["command"]).state
    assert "volumes" not in compose["services"]["worker"], "kernels are in the image"


def test_compose_shows_the_page_on_this_machine_alone(compose: dict[str, Any]) -> None:
    page = compose["services"]["page"]
    options = parsed(page["command"])
    assert (options.verb, options.listen) == ("web", ("127.0.0.1", 7480))
    assert page["network_mode"] == "host", "what listens on the loopback of a container is published to nobody"
    assert "ports" not in page
    (published,) = compose["services"]["coordinator"]["ports"]
    assert parse_address(page["environment"]["ATOLL_CONNECT"]).port == int(interpolated(published).split(":")[1])
    assert page["environment"]["ATOLL_WEB_TOKEN"] is None, "the variable of whoever calls docker compose, if it is set"


def test_the_image_copies_what_is_there_and_not_ignored(image: list[Instruction]) -> None:
    copied = [rest.split()[:-1] for rest in of(image, "COPY") if not rest.startswith("--from=build ")]
    sources = [source for words in copied for source in words]
    programs = {"pyproject.toml", "hatch_build.py", "README.md", "LICENSE", "common", "coordinator", "island_worker"}
    assert set(sources) == programs | {"deploy/entrypoint.sh"}
    assert [source for source in sources if not (ROOT / source).exists()] == []
    assert [source for source in sources if is_ignored(source)] == []
    assert is_ignored(".venv")
    assert is_ignored("tests")


def is_ignored(path: str) -> bool:
    """Say whether the last pattern of .dockerignore that fits a path at the top leaves it out."""
    ignored = False
    for line in (ROOT / ".dockerignore").read_text("utf-8").splitlines():
        pattern = line.strip().removeprefix("!")
        if pattern and not pattern.startswith("#") and fnmatch.fnmatch(path, pattern):
            ignored = not line.startswith("!")
    return ignored


def test_the_image_owns_the_folders_that_are_written(compose: dict[str, Any], final: list[Instruction]) -> None:
    owned = next(rest for rest in of(final, "RUN") if "chown" in rest).split("chown", 1)[1].split()
    written = {volume.split(":")[1] for volume in compose["services"]["coordinator"]["volumes"]}
    assert written | {environment(final)["ATOLL_KERNEL_CACHE"]} <= set(owned)


def test_the_image_knows_whether_its_coordinator_can_be_reached(final: list[Instruction]) -> None:
    (health,) = of(final, "HEALTHCHECK")
    command = shlex.split(health.split("||")[1])
    assert parsed(command).quick


def test_the_kernel_cache_is_where_the_image_says(image: list[Instruction], monkeypatch: pytest.MonkeyPatch) -> None:
    cache = environment(image)["ATOLL_KERNEL_CACHE"]
    monkeypatch.setenv("ATOLL_KERNEL_CACHE", cache)
    assert cache_directory("atoll_core").parent == Path(cache)


def test_python_in_the_image_names_what_exists(image: list[Instruction]) -> None:
    scripts = re.findall(r"python3? -c (?:\"([^\"]*)\"|'([^']*)')", " ".join(of(image, "RUN")))
    assert len(scripts) == 3
    imports = [
        node for pair in scripts for node in ast.walk(ast.parse("".join(pair))) if isinstance(node, ast.ImportFrom)
    ]
    names = [f"{node.module}:{alias.name}" for node in imports for alias in node.names]
    assert "atoll_island_worker.compute.warmup:warm_up" in names
    for name in names:
        assert callable(pkgutil.resolve_name(name))
