"""Rehearse a release without publishing it: ``python -m deploy.release`` (CONTRIBUTING.md says how one is made).

Builds the source distribution and from it the wheel, checks both, installs the wheel into a fresh environment beside a
foreign package named ``common``, runs both programs and a search there. Compiles the kernels for this Python and
processor, builds the wheel that brings them, and checks that its first search compiles nothing. Signs the files with a
key that is thrown away. Needs the package index; prints one line for each step and ends with 1 at the first that fails.
"""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TOOLS = ("build", "twine")


class FailedError(Exception):
    """Something is not fit for a release; the text says what."""


def main() -> int:
    """Run every step; return 1 if one failed."""
    with tempfile.TemporaryDirectory(prefix="atoll-release-") as folder:
        try:
            _rehearse(Path(folder))
        except FailedError as problem:
            print(f"failed: {problem}", file=sys.stderr)
            return 1
    return 0


def _rehearse(work: Path) -> None:
    _say("version", _check_version())
    tools = make_environment(work / "tools")
    run(tools / "pip", "install", "--quiet", *TOOLS)
    files = build_distributions(tools, work / "dist")
    _say("build", " and ".join(file.name for file in files))
    run(tools / "twine", "check", "--strict", *files)
    _say("metadata", "twine check --strict finds nothing")
    (wheel,) = (file for file in files if file.suffix == ".whl")
    _say("names", f"the wheel installs {', '.join(_check_names(wheel))}")
    python = install_wheel(work, wheel)
    _say("install", "beside a foreign package `common`; pip check finds nothing, all three packages are imported")
    _say("search", _search(work, python))
    files.append(build_wheel_with_kernels(tools, work, python))
    _say("kernels", _check_kernels(work, python, files[-1]))
    _say("signature", _sign(work / "gnupg", files))


def _check_version() -> str:
    """Return what is said of the version; raises FailedError unless package and changelog have it."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    said = re.search(
        r'^VERSION.* = "(.+)"$', (ROOT / "common" / "atoll_core" / "__init__.py").read_text("utf-8"), re.MULTILINE
    )
    if said is None or said[1] != version:
        raise FailedError(f"pyproject.toml has version {version}, which atoll.VERSION is not")
    changelog = (ROOT / "CHANGELOG.md").read_text("utf-8")
    if f"## [{version}]" not in changelog:
        raise FailedError(f"CHANGELOG.md has no section for {version}")
    unreleased = changelog.partition("## [Unreleased]")[2].partition("\n## [")[0].strip()
    note = "; before a release the changelog's section Unreleased becomes the version's" if unreleased else ""
    return f"{version} in pyproject.toml, in atoll.VERSION and in CHANGELOG.md{note}"


def build_distributions(tools: Path, folder: Path) -> list[Path]:
    """Return the source distribution, and the wheel that is built from it."""
    run(tools / "python", "-m", "build", "--outdir", folder, ROOT)
    return sorted(folder.iterdir())


def _check_names(wheel: Path) -> list[str]:
    """Return the top-level names of a wheel; raises FailedError for one that is not ours."""
    with zipfile.ZipFile(wheel) as archive:
        names = sorted({name.split("/")[0] for name in archive.namelist()})
    foreign = [name for name in names if not name.startswith("atoll")]
    if foreign:
        raise FailedError(f"the wheel would install {', '.join(foreign)}; every name has to begin with atoll")
    return [name for name in names if not name.endswith(".dist-info")]


def install_wheel(work: Path, wheel: Path) -> Path:
    """Return the Python of a fresh environment with the wheel and a package of a name that we once had."""
    foreign = work / "foreign"
    (foreign / "common").mkdir(parents=True)
    (foreign / "common" / "__init__.py").write_text("MINE = 1\n")
    (foreign / "pyproject.toml").write_text(
        '[build-system]\nrequires = ["hatchling"]\nbuild-backend = "hatchling.build"\n'
        '[project]\nname = "foreign-common"\nversion = "1"\n'
        '[tool.hatch.build.targets.wheel]\npackages = ["common"]\n'
    )
    programs = make_environment(work / "fresh")
    run(programs / "pip", "install", "--quiet", foreign, wheel)
    run(programs / "pip", "check")
    script = (
        "import common, atoll, atoll_coordinator, atoll_core, atoll_island_worker; "
        "assert common.MINE == 1; print(atoll.__file__)"
    )
    place = run(programs / "python", "-c", script, cwd=work).strip()
    if not place.startswith(str(work)):
        raise FailedError(f"atoll was imported from {place}, not from the wheel")
    return programs / "python"


def build_wheel_with_kernels(tools: Path, work: Path, python: Path) -> Path:
    """Return a wheel with compiled kernels for `python`, an environment with the wheel without them, and its numba."""
    kernels, folder = work / "kernels", work / "compiled"
    run(python, "-m", "deploy.kernels", kernels, cwd=ROOT)
    run(tools / "python", "-m", "build", "--wheel", "--outdir", folder, ROOT, ATOLL_WHEEL_KERNELS=str(kernels))
    (wheel,) = folder.iterdir()
    return wheel


def _check_kernels(work: Path, python: Path, wheel: Path) -> str:
    """Return what was found of a wheel with kernels; raises FailedError if a first search compiles one."""
    run(python.with_name("pip"), "install", "--quiet", "--force-reinstall", "--no-deps", wheel)
    cache, data = work / "cache", ROOT / "examples" / "lotka_volterra.csv"
    words = ("run", data, "--workers", "1", "--out", work / "first")
    run(python.with_name("coordinator"), *words, cwd=work, ATOLL_KERNEL_CACHE=str(cache))
    compiled = sorted(file.name for file in cache.rglob("*.nbc"))
    if compiled:
        raise FailedError(f"a first search with {wheel.name} compiled {', '.join(compiled)}")
    if not all(any(cache.glob(f"{package}-*/wheel-*")) for package in ("atoll_island_worker", "atoll_coordinator")):
        raise FailedError(f"a first search with {wheel.name} did not test its kernels")
    return f"a first search with {wheel.name} ({wheel.stat().st_size / 1e6:.1f} MB) compiles nothing"


def _search(work: Path, python: Path) -> str:
    """Return what both programs and a search from the wheel said."""
    versions = [run(python.with_name(name), "--version", cwd=work).strip() for name in ("coordinator", "island-worker")]
    data = ROOT / "examples" / "lotka_volterra.csv"
    run(python.with_name("coordinator"), "run", data, "--workers", "1", "--out", work / "out", cwd=work)
    result = json.loads((work / "out" / "result.json").read_text("utf-8"))
    equations = [f"{each['lhs']} = {each['expression']}" for each in result["equations"]]
    verdicts = {each["verdict"] for each in result["equations"]}
    if verdicts != {"exact"}:
        raise FailedError(f"{'; '.join(equations)} have verdicts {verdicts}, but exact was expected")
    return f"{', '.join(versions)}; {'; '.join(equations)}"


def _sign(home: Path, files: list[Path]) -> str:
    """Sign the files' hashes with a key of no account and verify that; a changed file has to be noticed."""
    if not shutil.which("gpg"):
        return "not possible here: gpg not found"
    sums = files[0].with_name("SHA256SUMS")
    sums.write_text("".join(f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n" for file in files))
    home.mkdir(mode=0o700)
    gpg = ("gpg", "--homedir", home, "--batch", "--quiet", "--pinentry-mode", "loopback", "--passphrase", "")
    try:
        run(*gpg, "--quick-generate-key", "rehearsal@example.invalid", "ed25519", "sign", "1d")
        run(*gpg, "--armor", "--detach-sign", sums)
        run(*gpg, "--verify", f"{sums}.asc", sums)
        sums.write_text(sums.read_text().replace("a", "b"))
        if subprocess.run([*gpg, "--verify", f"{sums}.asc", sums], capture_output=True, check=False).returncode == 0:
            raise FailedError("gpg did not notice that SHA256SUMS was changed")
    finally:
        subprocess.run(["gpgconf", "--homedir", home, "--kill", "all"], capture_output=True, check=False)
    return "SHA256SUMS signed with gpg and a key for this rehearsal, verified; a change is noticed"


def make_environment(folder: Path) -> Path:
    """Make a virtual environment and return the folder of its programs."""
    run(sys.executable, "-m", "venv", folder)
    return folder / "bin"


def run(*words: str | Path, cwd: Path | None = None, **settings: str) -> str:
    """Return what a program prints, with `settings` in its environment; raises FailedError if its code is not 0."""
    outside = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False, cwd=cwd,
        env={**outside, "PIP_DISABLE_PIP_VERSION_CHECK": "1", **settings},
    )  # fmt: skip
    if done.returncode != 0:
        said = "\n".join((done.stdout + done.stderr).strip().splitlines()[-20:])
        raise FailedError(f"{' '.join(map(str, words))} ended with {done.returncode}:\n{said}")
    return done.stdout


def _say(step: str, text: str) -> None:
    print(f"{step:10} passed: {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
