"""Scripts of deploy/: what they choose, start and stop; run with stand-ins for ssh and for Atoll's programs."""

import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from atoll.cli import parser as arguments
from atoll_coordinator.result.result import Result
from atoll_island_worker import cli as worker_cli
from tests.unit.documents import ROOT

DEPLOY = ROOT / "deploy"
TOGETHER = DEPLOY / "slurm" / "together"
SCRIPTS = (DEPLOY / "entrypoint.sh", DEPLOY / "ssh" / "workers", DEPLOY / "slurm" / "atoll.sbatch", TOGETHER)
LIMIT_S = 30

pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="scripts need bash")


def run(*words: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in words],
        env={**os.environ, **environment}, capture_output=True, text=True, timeout=LIMIT_S, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.name)
def test_scripts_are_of_one_piece(script: Path) -> None:
    assert run("bash", "-n", script).returncode == 0


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="shellcheck is not installed")
def test_scripts_have_nothing_that_shellcheck_minds() -> None:
    done = run("shellcheck", *SCRIPTS)
    assert done.returncode == 0, done.stdout


# ------------------------------------------------------------------------------------------- the image's

FAST = "flags\t\t: fpu avx2 bmi2 fma f16c movbe abm\n"
SLOW = "flags\t\t: fpu sse2 avx\n"


@pytest.fixture
def kernels(tmp_path: Path) -> Path:
    (tmp_path / "kinds").write_text("x86-64-v3\ngeneric\n")
    return tmp_path


def chosen(kernels: Path, flags: str, **more: str) -> str:
    """Return for which processor a program in the image would load kernels; "-" for the one it is on."""
    (kernels / "cpuinfo").write_text(f"processor: 0\n{flags}")
    environment = {"ATOLL_KERNEL_CACHE": str(kernels), "ATOLL_CPUINFO": str(kernels / "cpuinfo"), **more}
    done = run("sh", DEPLOY / "entrypoint.sh", "sh", "-c", 'echo "${NUMBA_CPU_NAME:--}"', **environment)
    return done.stdout.strip()


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="other processors have one kind")
def test_the_image_loads_the_fastest_kernels_that_the_processor_can_run(kernels: Path) -> None:
    assert chosen(kernels, FAST) == "x86-64-v3"
    assert chosen(kernels, SLOW) == "generic"
    assert chosen(kernels, FAST.replace("fma ", "fma4 ")) == "generic"


def test_the_image_loads_only_what_was_compiled_and_what_was_chosen_stays(kernels: Path) -> None:
    assert chosen(kernels, FAST, NUMBA_CPU_NAME="znver4") == "znver4"
    (kernels / "kinds").write_text("generic\n")
    assert chosen(kernels, FAST) == "generic"
    (kernels / "kinds").unlink()
    assert chosen(kernels, FAST) == "-"


# ---------------------------------------------------------------------------------------------- by ssh


@pytest.fixture
def lab(tmp_path: Path) -> dict[str, str]:
    """An ssh that runs everything here, in a home folder for each machine, but does not reach `off`."""
    programs = tmp_path / "bin"
    programs.mkdir()
    ssh = programs / "ssh"
    ssh.write_text(
        "#!/bin/bash\n"
        "while [[ $1 == -* ]]; do [[ $1 == -o ]] && shift; shift; done\n"
        '[[ $1 != off ]] || { echo "no route to host" >&2; exit 255; }\n'
        f'mkdir -p {tmp_path}/$1 && cd {tmp_path}/$1 && exec sh -c "$2"\n'
    )
    worker = programs / "worker"
    worker.write_text('#!/bin/bash\necho "$@"\nexec sleep 60\n')
    for file in (ssh, worker):
        file.chmod(0o755)
    return {"PATH": f"{programs}:{os.environ['PATH']}", "ATOLL_PROGRAM": "worker", "HOME": str(tmp_path)}


def workers(lab: dict[str, str], command: str, hosts: str, *options: str) -> subprocess.CompletedProcess[str]:
    file = Path(lab["HOME"]) / "hosts"
    file.write_text(hosts)
    return run("bash", DEPLOY / "ssh" / "workers", command, file, *options, **lab)


@pytest.mark.parametrize("began", ["", "long ago\n"])
def test_a_process_that_has_the_number_of_a_worker_is_not_signalled(lab: dict[str, str], began: str) -> None:
    folder = Path(lab["HOME"]) / "a" / ".atoll-worker"
    folder.mkdir(parents=True)
    with subprocess.Popen(["sleep", "60"]) as foreign:
        (folder / "pid").write_text(f"{foreign.pid}\n{began}")
        assert workers(lab, "status", "a\n").stdout == "a: does not run\n"
        assert workers(lab, "stop", "a\n").stdout == "a: does not run\n"
        assert foreign.poll() is None
        foreign.kill()


@pytest.mark.slow
def test_workers_are_started_once_looked_at_and_stopped_by_ssh(lab: dict[str, str]) -> None:
    hosts = "a # fast\n\n# none\nb\n"
    try:
        started = workers(lab, "start", hosts, "--connect", "tcp/lab1:7447", "--processes", "2")
        assert (started.returncode, sorted(started.stdout.splitlines())) == (0, ["a: started", "b: started"])
        pid = int((Path(lab["HOME"]) / "a" / ".atoll-worker" / "pid").read_text().split()[0])
        assert "--connect tcp/lab1:7447 --processes 2" in workers(lab, "status", hosts).stdout
        again = workers(lab, "start", hosts, "--connect", "tcp/lab1:7447")
        assert sorted(again.stdout.splitlines()) == ["a: runs already", "b: runs already"]
    finally:
        stopped = workers(lab, "stop", hosts)
    assert sorted(stopped.stdout.splitlines()) == ["a: stopped", "b: stopped"]
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert workers(lab, "status", hosts).returncode == 1


def test_a_machine_that_is_off_is_named_and_keeps_nobody_from_starting(lab: dict[str, str]) -> None:
    try:
        done = workers(lab, "start", "off\na\n", "--connect", "tcp/lab1:7447")
        assert done.returncode == 1
        assert sorted(done.stdout.splitlines()) == ["a: started", "off: no route to host"]
    finally:
        workers(lab, "stop", "a\n")


def test_a_worker_that_ends_at_once_is_said_with_its_last_words(lab: dict[str, str]) -> None:
    done = workers({**lab, "ATOLL_PROGRAM": "no-such-program"}, "start", "a\n", "--connect", "tcp/lab1:7447")
    assert done.returncode == 1
    assert "not found" in done.stdout or "No such file" in done.stdout


@pytest.mark.parametrize(
    ("command", "hosts", "options"),
    [
        ("start", "a\n", ()),
        ("start", "a\n", ("--connect", "tcp/lab1:1; rm")),
        ("start", "-oProxyCommand=x\n", ("--connect", "tcp/lab1:1")),
        ("start", "# nobody\n", ("--connect", "tcp/lab1:1")),
        ("stop", "a\n", ("--connect", "tcp/lab1:1")),
        ("pause", "a\n", ()),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_sentence(
    lab: dict[str, str], command: str, hosts: str, options: tuple[str, ...]
) -> None:
    done = workers(lab, command, hosts, *options)
    assert done.returncode == 2
    assert done.stderr.startswith("workers: ")
    assert done.stderr.count("\n") == 1


# ---------------------------------------------------------------------------------------------- Slurm


def test_slurm_starts_programs_with_options_that_they_have() -> None:
    text = SCRIPTS[2].read_text("utf-8").replace("\\\n", " ")
    plain = re.sub(r'"\$\((?:[^()]|\([^()]*\))*\)"|"\$[^"]*"', "tcp/a:1", text)
    serve = next(line for line in plain.splitlines() if line.startswith("coordinator serve"))
    submit = next(line for line in plain.splitlines() if line.startswith("coordinator submit"))
    worker = next(line for line in plain.splitlines() if "island-worker --" in line)
    options = arguments.parse(serve.split(">>")[0].split()[1:])
    assert (options.verb, options.listen) == ("serve", "tls/0.0.0.0:0")
    assert options.connect_file
    assert arguments.parse(submit.removesuffix("&").split()[1:]).id
    assert worker_cli._parse(worker.split("island-worker")[1].removesuffix("&").split()).connect_file


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_slurm_lets_in_only_who_may_read_the_folder_of_the_job(tmp_path: Path) -> None:
    """Its programs are stand-ins, of which the coordinator looks at what it would listen with."""
    programs, folder = tmp_path / "bin", tmp_path / "job"
    programs.mkdir()
    code = (
        "import os; from pathlib import Path; from atoll_core.wire.security.credentials import credentials_of\n"
        "sides = [credentials_of({}, os.environ, use) for use in ('serve', 'connect')]\n"
        "Path(os.environ['SAID']).write_text(f'{sides[0].name} {\",\".join(sides[0].hosts)}')\n"
    )
    (programs / "coordinator").write_text(f'#!/bin/bash\n[[ $1 == serve ]] && {sys.executable} -c "$CODE"\nexit 1\n')
    for name in ("srun", "scancel"):
        (programs / name).write_text("#!/bin/bash\n")
    for file in programs.iterdir():
        file.chmod(0o755)
    data = tmp_path / "data.csv"
    data.write_text("t,x\n")
    done = run(
        "bash", SCRIPTS[2], data, PATH=f"{programs}:{os.environ['PATH']}", SLURM_JOB_ID="7", CODE=code,
        ATOLL_DIR=str(folder), SAID=str(tmp_path / "said"),
    )  # fmt: skip
    assert done.returncode == 1
    name, hosts = (tmp_path / "said").read_text().split()
    assert name == "atoll"
    assert {"localhost", "127.0.0.1", socket.gethostname()} <= set(hosts.split(","))
    assert folder.stat().st_mode & 0o077 == 0
    assert all(file.stat().st_mode & 0o077 == 0 for file in folder.rglob("*"))


# ---------------------------------------------------------------------------------------------- one srun


def test_tasks_of_one_srun_have_options_that_the_programs_have() -> None:
    text = TOGETHER.read_text("utf-8").replace("\\\n", " ")
    plain = re.sub(r'"\$\((?:[^()"]|"[^"]*")*\)"|"\$[^"]*"', "tcp/a:1", text)
    serve = re.search(r"coordinator serve ([^>]*)>>", plain)
    submit = re.search(r"coordinator (submit .*) &", plain)
    worker = re.search(r"island-worker (--connect-file [^>]*)>>", plain)
    assert serve
    assert submit
    assert worker
    options = arguments.parse(["serve", *serve[1].split()])
    assert options.listen == "tls/0.0.0.0:0"
    assert options.connect_file
    assert options.roster
    assert arguments.parse(submit[1].split()).id
    assert worker_cli._parse(worker[1].split()).connect_file


def test_a_task_of_mpirun_goes_by_its_number_there_and_by_no_file_of_an_earlier_run(tmp_path: Path) -> None:
    """Under sbatch, all tasks that mpirun starts on the first node have SLURM_PROCID=0."""
    data, folder, called = tmp_path / "data.csv", tmp_path / "job", tmp_path / "called"
    data.write_text("t,x\n")
    folder.mkdir()
    for name in ("ended-0", "ended-5-", "address-17-1"):
        (folder / name).write_text("there\n")
    (tmp_path / "island-worker").write_text(f'#!/bin/sh\necho "$@" >{called}\n')
    (tmp_path / "island-worker").chmod(0o755)
    done = run(
        "bash", TOGETHER, data, PATH=f"{tmp_path}:{os.environ['PATH']}", ATOLL_DIR=str(folder), SLURM_JOB_ID="5",
        SLURM_PROCID="0", OMPI_COMM_WORLD_RANK="1", PMIX_RANK="1", PMIX_NAMESPACE="17@1",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert called.read_text().split()[:2] == ["--connect-file", str(folder / "address-17-1")]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_the_first_task_of_one_srun_serves_and_all_end_with_the_job(tmp_path: Path) -> None:
    data = tmp_path / "data.csv"
    head, *rows = (ROOT / "examples" / "lotka_volterra.csv").read_text("utf-8").splitlines(keepends=True)
    data.write_text(head + "".join(rows[::10]), "utf-8")
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    given = {**os.environ, "PATH": path, "SLURM_JOB_ID": "5", "SLURM_STEP_ID": "0", "ATOLL_DIR": str(tmp_path / "job")}
    tasks = [
        subprocess.Popen(["bash", str(TOGETHER), str(data)], env=given | {"SLURM_PROCID": task}, cwd=tmp_path)
        for task in ("1", "0")
    ]
    try:
        assert [task.wait(250) for task in tasks] == [0, 0]
    finally:
        for task in tasks:
            task.kill()
    assert Result.load(tmp_path / "job" / "result").equations
    logs = [(tmp_path / "job" / f"worker-{task}.log").read_text("utf-8") for task in (0, 1)]
    assert all("this worker ends" in log for log in logs)
    assert (tmp_path / "job").stat().st_mode & 0o077 == 0
