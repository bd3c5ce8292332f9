"""The manifests, as far as they can be judged without a cluster: they fit each other and the programs."""

import argparse
import json
import re
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml

from atoll.cli import parser as arguments
from atoll_coordinator.service.scheduling.limits import MAX_RUNNING
from atoll_core.config import JobConfig
from atoll_core.wire.addresses import parse_address
from atoll_core.wire.messages.views import JobState
from atoll_island_worker import cli as worker_cli
from tests.unit.documents import ROOT

BASE = ROOT / "deploy" / "kubernetes" / "base"
TLS = ROOT / "deploy" / "kubernetes" / "tls"
KEDA = ROOT / "deploy" / "kubernetes" / "keda"


def documents(folder: Path) -> dict[tuple[str, str], dict[str, Any]]:
    """Return what the files that a kustomization lists hold, by kind and name."""
    listed = yaml.safe_load((folder / "kustomization.yaml").read_text("utf-8"))
    files = [name for name in listed["resources"] if name.endswith(".yaml")]
    files += [patch["path"] for patch in listed.get("patches", []) if "path" in patch]
    manifests = [manifest for name in files for manifest in yaml.safe_load_all((folder / name).read_text("utf-8"))]
    return {(manifest["kind"], manifest["metadata"]["name"]): manifest for manifest in manifests}


@pytest.fixture(scope="module")
def base() -> dict[tuple[str, str], dict[str, Any]]:
    return documents(BASE)


def pod(manifest: dict[str, Any]) -> dict[str, Any]:
    spec: dict[str, Any] = manifest["spec"]["template"]["spec"]
    return spec


def container(manifest: dict[str, Any]) -> dict[str, Any]:
    (container_spec,) = pod(manifest)["containers"]
    manifests: dict[str, Any] = container_spec
    return manifests


def environment(manifest: dict[str, Any]) -> dict[str, str]:
    return {variable["name"]: variable["value"] for variable in container(manifest)["env"] if "value" in variable}


def parsed(words: list[str]) -> argparse.Namespace:
    """Return the options of a command as its program reads them; raises UsageError."""
    return arguments.parse(words[1:]) if words[0] == "coordinator" else worker_cli._parse(words[1:])


def test_every_manifest_is_listed(base: dict[tuple[str, str], dict[str, Any]]) -> None:
    for folder in (BASE, TLS, KEDA):
        listed = yaml.safe_load((folder / "kustomization.yaml").read_text("utf-8"))
        named = {*listed["resources"], *(patch["path"] for patch in listed.get("patches", []) if "path" in patch)}
        files = {file.name for file in folder.glob("*.yaml")} - {"kustomization.yaml"}
        assert files == {name for name in named if name.endswith(".yaml")}


def test_the_coordinator_is_one_keeps_its_store_and_listens_where_its_service_leads(
    base: dict[tuple[str, str], dict[str, Any]],
) -> None:
    spec, service = base["StatefulSet", "coordinator"], base["Service", "coordinator"]
    options = parsed(container(spec)["args"])
    assert options.verb == "serve"
    assert spec["spec"]["replicas"] == 1
    assert spec["spec"]["serviceName"] == service["metadata"]["name"]
    (port,) = container(spec)["ports"]
    assert parse_address(options.listen).port == port["containerPort"] == service["spec"]["ports"][0]["port"]
    assert service["spec"]["ports"][0]["targetPort"] == port["name"]
    (mount,) = container(spec)["volumeMounts"]
    (claim,) = spec["spec"]["volumeClaimTemplates"]
    assert (mount["name"], mount["mountPath"]) == (claim["metadata"]["name"], options.state)
    assert parsed(container(spec)["livenessProbe"]["exec"]["command"]).verb == "ping"


def test_workers_dial_the_service_and_have_time_to_hand_over(base: dict[tuple[str, str], dict[str, Any]]) -> None:
    spec = base["Deployment", "worker"]
    address = parse_address(environment(spec)["ATOLL_CONNECT"])
    port = base["Service", "coordinator"]["spec"]["ports"][0]["port"]
    assert (address.host, address.port) == ("coordinator", port)
    assert parsed(container(spec)["args"]).processes == 1
    assert container(spec)["resources"]["requests"]["cpu"] == "1"
    assert pod(spec)["terminationGracePeriodSeconds"] >= parsed(container(spec)["args"]).grace + 10
    assert "replicas" not in spec["spec"], "the autoscaler decides"


def test_nobody_is_root_or_may_become_more_than_it_is(base: dict[tuple[str, str], dict[str, Any]]) -> None:
    for key in (("StatefulSet", "coordinator"), ("Deployment", "worker"), ("Deployment", "page")):
        spec = base[key]
        assert pod(spec)["securityContext"]["runAsNonRoot"]
        assert pod(spec)["securityContext"]["runAsUser"] == 10001
        assert container(spec)["securityContext"] == {
            "allowPrivilegeEscalation": False,
            "capabilities": {"drop": ["ALL"]},
        }


def test_with_certificates_both_sides_speak_tls_and_their_files_are_mounted(
    base: dict[tuple[str, str], dict[str, Any]],
) -> None:
    for key, patch in documents(TLS).items():
        assert key in base
        address = parse_address(environment(patch)["ATOLL_CONNECT"])
        assert address.protocol == "tls"
        (mount,) = container(patch)["volumeMounts"]
        (volume,) = pod(patch)["volumes"]
        assert mount["name"] == volume["name"]
        files = [value for name, value in environment(patch).items() if name.startswith("ATOLL_TLS_")]
        assert len(files) == 3
        assert all(value.startswith(mount["mountPath"] + "/") for value in files)
    coordinator = documents(TLS)["StatefulSet", "coordinator"]
    options = parsed(container(coordinator)["args"])
    assert parse_address(options.listen).protocol == "tls"
    assert options.roster.startswith("/tls/")
    assert "livenessProbe" not in container(coordinator)  # the one without certificates serves here as well


@pytest.fixture(scope="module")
def keda() -> dict[tuple[str, str], dict[str, Any]]:
    return documents(KEDA)


def metrics_address(keda: dict[tuple[str, str], dict[str, Any]]) -> tuple[list[str], str]:
    """Return the coordinator's command without the address of its metrics, and that address."""
    words = list(container(keda["StatefulSet", "coordinator"])["args"])
    place = words.index("--metrics")
    address = words[place + 1]
    return words[:place] + words[place + 2 :], address


def test_keda_scales_the_workers_and_nothing_else_does(
    base: dict[tuple[str, str], dict[str, Any]], keda: dict[tuple[str, str], dict[str, Any]]
) -> None:
    spec = keda["ScaledObject", "worker"]["spec"]
    target = spec["scaleTargetRef"]
    assert base[target["kind"], target["name"]]["apiVersion"] == target["apiVersion"]
    listed = yaml.safe_load((KEDA / "kustomization.yaml").read_text("utf-8"))
    (deleted,) = [yaml.safe_load(patch["patch"]) for patch in listed["patches"] if "patch" in patch]
    scaler = base["HorizontalPodAutoscaler", "worker"]
    assert (deleted["$patch"], deleted["kind"], deleted["metadata"]) == ("delete", scaler["kind"], scaler["metadata"])
    assert deleted["apiVersion"] == scaler["apiVersion"]
    assert spec["maxReplicaCount"] == scaler["spec"]["maxReplicas"]
    down = spec["advanced"]["horizontalPodAutoscalerConfig"]["behavior"]["scaleDown"]
    assert down == scaler["spec"]["behavior"]["scaleDown"]


def test_keda_wants_as_many_workers_as_the_coordinator_says(keda: dict[tuple[str, str], dict[str, Any]]) -> None:
    (trigger,) = keda["ScaledObject", "worker"]["spec"]["triggers"]
    ready, per_job, states, jobs = re.fullmatch(  # type: ignore[union-attr]
        r"sum\((\w+)\) \+ (\d+) \* clamp_max\(sum\(atoll_jobs\{state=~\"([^\"]+)\"\}\), (\d+)\)",
        trigger["metadata"]["query"],
    ).groups()
    assert ready == "atoll_tasks_ready"
    assert int(per_job) == JobConfig().evolution.islands
    assert set(states.split("|")) < set(get_args(JobState))
    assert int(jobs) == MAX_RUNNING
    assert int(trigger["metadata"]["threshold"]) == parsed(["island-worker", "--processes", "1"]).processes


def test_the_metrics_are_served_where_prometheus_looks(
    base: dict[tuple[str, str], dict[str, Any]], keda: dict[tuple[str, str], dict[str, Any]]
) -> None:
    coordinator = keda["StatefulSet", "coordinator"]
    words, address = metrics_address(keda)
    assert words == container(base["StatefulSet", "coordinator"])["args"], "nothing else is changed"
    host, _, port = address.rpartition(":")
    assert host == "0.0.0.0"
    (opened,) = container(coordinator)["ports"]
    annotations = coordinator["spec"]["template"]["metadata"]["annotations"]
    assert annotations["prometheus.io/port"] == port == str(opened["containerPort"])
    policy = keda["NetworkPolicy", "metrics"]["spec"]
    assert policy["ingress"][0]["ports"][0]["port"] == opened["name"]
    assert policy["podSelector"] == base["NetworkPolicy", "coordinator"]["spec"]["podSelector"]
    namespace = policy["ingress"][0]["from"][0]["namespaceSelector"]["matchLabels"]["kubernetes.io/metadata.name"]
    (trigger,) = keda["ScaledObject", "worker"]["spec"]["triggers"]
    assert f".{namespace}.svc:" in trigger["metadata"]["serverAddress"]


def test_a_client_that_is_started_by_hand_may_run_in_the_namespace(base: dict[tuple[str, str], dict[str, Any]]) -> None:
    """The namespace is `restricted`: a pod without these settings is refused."""
    readme = (ROOT / "deploy" / "README.md").read_text("utf-8")
    assert '--override-type strategic --overrides "$(cat deploy/kubernetes/client.json)"' in readme
    client = json.loads((ROOT / "deploy" / "kubernetes" / "client.json").read_text("utf-8"))["spec"]
    worker = pod(base["Deployment", "worker"])
    assert client["securityContext"] == worker["securityContext"]
    (one,) = client["containers"]
    assert one == {"name": "submit", "securityContext": worker["containers"][0]["securityContext"]}
    assert "run --rm -i submit " in readme  # the container has the name of the pod
