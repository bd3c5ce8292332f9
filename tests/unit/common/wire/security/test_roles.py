"""Who may say what: role bindings that are accepted, and rules that fence each name in."""

import fnmatch
import itertools
from pathlib import Path

import pytest

from atoll_core.errors import UsageError
from atoll_core.wire import topics
from atoll_core.wire.security.roles import (
    Flow,
    RoleBindings,
    access_control,
    checked_role_bindings,
    permissions,
    read_role_bindings,
)

ROLE_BINDINGS = RoleBindings({"lab1": "worker", "lab2": "worker", "ann": "submitter", "eve": "admin"})
CLUSTER = "0123456789ab"
DIGEST = "0" * 64


def may(name: str, flow: Flow, message: str, key: str, role_bindings: RoleBindings = ROLE_BINDINGS) -> bool:
    """Return whether the rules for `name` let this message pass."""
    rules = permissions(name, role_bindings.roles[name])
    return any(
        rule.flow == flow and message in rule.messages and any(covers(expression, key) for expression in rule.keys)
        for rule in rules
    )


def covers(expression: str, key: str) -> bool:
    """Return whether a key expression, perhaps with ``$*`` within a chunk, covers a key; ``**`` only at its end."""
    wanted, chunks = expression.split("/"), key.split("/")
    if wanted[-1] == "**":
        wanted, chunks = wanted[:-1], chunks[: len(wanted) - 1]
    if len(wanted) != len(chunks):
        return False
    return all(fnmatch.fnmatchcase(word, part.replace("$*", "*")) for part, word in zip(wanted, chunks, strict=True))


@pytest.mark.parametrize("process", ["lab1", "lab1-0", "lab1-host-4711-12"])
def test_a_worker_speaks_under_its_own_names(process: str) -> None:
    for part in ("status", "report"):
        assert may("lab1", "ingress", "put", topics.worker(CLUSTER, process, part))  # type: ignore[arg-type]
    assert may("lab1", "ingress", "liveliness_token", topics.worker(CLUSTER, process, "alive"))
    assert may("lab1", "ingress", "query", topics.hello(process))
    for message in ("declare_queryable", "reply"):
        assert may("lab1", "ingress", message, topics.worker(CLUSTER, process, "pull"))
    for flow, message in (("ingress", "declare_subscriber"), ("egress", "put")):
        for key in (topics.control(CLUSTER), topics.control(CLUSTER, process)):
            assert may("lab1", flow, message, key)  # type: ignore[arg-type]


@pytest.mark.parametrize("other", ["lab2", "lab2-0", "lab10", "lab", "lab1x"])
def test_a_worker_does_not_speak_for_others_or_read_their_messages(other: str) -> None:
    for part in ("status", "report", "alive", "pull"):
        for message in ("put", "liveliness_token", "declare_queryable", "reply"):
            assert not may("lab1", "ingress", message, topics.worker(CLUSTER, other, part))  # type: ignore[arg-type]
    assert not may("lab1", "ingress", "query", topics.hello(other))
    assert not may("lab1", "ingress", "declare_subscriber", topics.control(CLUSTER, other))
    assert not may("lab1", "egress", "put", topics.control(CLUSTER, other))


def test_a_worker_neither_submits_nor_commands() -> None:
    for client in ("ann-1", "lab1-1", "lab1"):
        assert not may("lab1", "ingress", "query", topics.client(CLUSTER, client))
    for key in (topics.control(CLUSTER), topics.control(CLUSTER, "lab1"), topics.control(CLUSTER, "lab2")):
        assert not may("lab1", "ingress", "put", key)
    for key in (topics.states(CLUSTER, "j"), topics.blob(CLUSTER, DIGEST, 0), topics.HELLO):
        assert not may("lab1", "ingress", "declare_queryable", key)
        assert not may("lab1", "ingress", "reply", key)


@pytest.mark.parametrize("name", ["ann", "eve"])
def test_a_client_asks_under_its_own_name_and_does_nothing_else(name: str) -> None:
    assert may(name, "ingress", "query", topics.client(CLUSTER, f"{name}-0123456789ab"))
    assert may(name, "egress", "reply", topics.client(CLUSTER, f"{name}-0123456789ab"))
    assert not may(name, "ingress", "query", topics.client(CLUSTER, "bob-1"))
    keys = [
        topics.control(CLUSTER),
        topics.control(CLUSTER, "lab1"),
        topics.states(CLUSTER, "j"),
        topics.blob(CLUSTER, DIGEST, 0),
        *(
            topics.worker(CLUSTER, who, part)
            for who in ("lab1", name)
            for part in ("status", "report", "alive", "pull")
        ),  # type: ignore[arg-type]
    ]
    messages = ("put", "query", "declare_subscriber", "declare_queryable", "liveliness_token", "reply")
    for key, message, flow in itertools.product(keys, messages, ("ingress", "egress")):
        assert not may(name, flow, message, key), (flow, message, key)  # type: ignore[arg-type]


def test_everything_else_is_denied_and_every_rule_belongs_to_one_name() -> None:
    setting = access_control(ROLE_BINDINGS)
    assert setting["enabled"] is True
    assert setting["default_permission"] == "deny"
    rules, policies = setting["rules"], setting["policies"]
    assert isinstance(rules, list)
    assert isinstance(policies, list)
    assert len({rule["id"] for rule in rules}) == len(rules)
    assert sorted(rule for policy in policies for rule in policy["rules"]) == sorted(rule["id"] for rule in rules)
    assert [policy["subjects"] for policy in policies] == [["lab1"], ["lab2"], ["ann"], ["eve"], ["(anybody)"]]
    (anybody,) = [subject for subject in setting["subjects"] if "cert_common_names" not in subject]  # type: ignore[attr-defined]
    assert anybody["id"] == "(anybody)"
    keys = {key for rule in rules if rule["id"].startswith("(anybody)") for key in rule["key_exprs"]}
    assert keys == {topics.HELLO}


def test_a_name_is_borne_by_the_certificate_that_it_begins_with() -> None:
    role_bindings = RoleBindings({"lab1": "worker", "gpu-room": "worker"})
    principals = {
        name: role_bindings.principal(name) for name in ("lab1", "lab1-0", "lab1-a-b", "lab10", "gpu-room-3", "gpu", "")
    }
    assert principals == {
        "lab1": "lab1",
        "lab1-0": "lab1",
        "lab1-a-b": "lab1",
        "lab10": None,
        "gpu-room-3": "gpu-room",
        "gpu": None,
        "": None,
    }


@pytest.mark.parametrize(
    ("entries", "reason"),
    [
        ({}, "0 names"),
        ({"a b": "worker"}, "letters, digits"),
        ({"x" * 49: "worker"}, "1 to 48"),
        ({"lab1": "boss"}, "one of coordinator, router, worker, submitter, admin"),
        ({"lab1": 3}, "role 3"),
        ({"lab": "worker", "lab-gpu": "submitter"}, "lab and lab-gpu"),
        ({"lab-gpu-1": "submitter", "lab": "worker"}, "lab and lab-gpu-1"),
    ],
)
def test_role_bindings_that_cannot_be_are_refused(entries: dict[str, object], reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        checked_role_bindings(entries, "roster.toml")


def test_role_bindings_are_read_from_toml(tmp_path: Path) -> None:
    file = tmp_path / "roster.toml"
    file.write_text('# who\nlab1 = "worker"\nann = "submitter"\n')
    assert read_role_bindings(file).roles == {"lab1": "worker", "ann": "submitter"}
    file.write_text("lab1 worker\n")
    with pytest.raises(UsageError, match='should be: name = "role"'):
        read_role_bindings(file)
    with pytest.raises(UsageError, match="no such file"):
        read_role_bindings(tmp_path / "other.toml")
