"""A Grid Engine of one node, with the programs of Debian's packages and all of its files in a folder of its own."""

import os
import socket
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

from deploy.rehearsal.machine import Machine, NotPossibleError, free_port, wait_until

PROGRAMS = {"qsub": "gridengine-client", "sge_qmaster": "gridengine-master", "sge_execd": "gridengine-exec"}
LIBRARY, SHARED = Path("/usr/lib/gridengine"), Path("/usr/share/gridengine")
BOOTSTRAP = """\
admin_user root
default_domain none
ignore_fqdn false
spooling_method berkeleydb
spooling_lib libspoolb
spooling_params {root}/spool
binary_path {library}
qmaster_spool_dir {root}/qmaster
security_mode none
listener_threads 2
worker_threads 2
scheduler_threads 1
"""
CONFIGURATION = {"execd_spool_dir": "{root}/execd", "min_uid": "0", "min_gid": "0"}
"""What differs from Debian's: where the node keeps its files, and that root may have jobs."""
PARALLEL = {
    "pe_name": "smp", "slots": "999", "user_lists": "NONE", "xuser_lists": "NONE", "start_proc_args": "NONE",
    "stop_proc_args": "NONE", "allocation_rule": "$pe_slots", "control_slaves": "FALSE", "job_is_first_task": "TRUE",
    "urgency_slots": "min", "accounting_summary": "FALSE", "qsort_args": "NONE",
}  # fmt: skip
LIMITS = ("rt", "cpu", "fsize", "data", "stack", "core", "rss", "vmem")
QUEUE = {
    "qname": "main", "hostlist": "{host}", "seq_no": "0", "nsuspend": "1", "suspend_interval": "00:05:00",
    "priority": "0", "min_cpu_interval": "00:05:00", "processors": "UNDEFINED", "qtype": "BATCH", "pe_list": "smp",
    "rerun": "FALSE", "slots": "{cores}", "tmpdir": "/tmp", "shell": "/bin/sh", "shell_start_mode": "posix_compliant",
    "notify": "00:00:60", "initial_state": "default",
} | dict.fromkeys(
    ("load_thresholds", "suspend_thresholds", "ckpt_list", "prolog", "epilog", "starter_method", "suspend_method",
     "resume_method", "terminate_method", "owner_list", "user_lists", "xuser_lists", "subordinate_list",
     "complex_values", "projects", "xprojects", "calendar"), "NONE",
) | {f"{kind}_{limit}": "INFINITY" for limit in LIMITS for kind in "sh"}  # fmt: skip


@dataclass(frozen=True)
class GridEngine:
    """A Grid Engine of one node; calling it runs a program of Grid Engine and returns what it prints."""

    machine: Machine
    folder: Path
    environment: tuple[str, ...]
    cores: int

    title = "Grid Engine"

    def __call__(self, *words: str) -> str:
        return self.machine.run(*self.environment, *words).stdout.strip()

    @property
    def adapt_options(self) -> tuple[str, ...]:
        """Options of ``coordinator adapt``; the output of a job is in ``folder``."""
        return ("--batch", "sge", f"--batch-options=-o {self.folder} -l h_rt=1:00:00")

    def jobs(self) -> dict[str, bool]:
        """Return whether each job runs, by its id."""
        found = ElementTree.fromstring(self("qstat", "-xml", "-u", "*")).iter("job_list")
        return {each.findtext("JB_job_number", ""): each.get("state") == "running" for each in found}

    def kill(self, number: str) -> None:
        """End a job as when its node is lost."""
        self.machine.kill(f"JOB_ID={number}")

    def output(self, number: str) -> str:
        """Return what a job printed."""
        (file,) = self.folder.glob(f"*.o{number}")
        return file.read_text("utf-8")


def start_grid_engine(machine: Machine, name: str) -> GridEngine:
    """Start a Grid Engine that keeps its files in a folder of this name.

    Raises:
        NotPossibleError: Grid Engine is not installed, or this is not root.
    """
    if os.geteuid() != 0:
        raise NotPossibleError("a node of Grid Engine runs jobs as their users, which needs root")
    machine.need(PROGRAMS)
    if not LIBRARY.exists():
        raise NotPossibleError(f"{LIBRARY} is not there: qsub is that of another batch system")
    folder = machine.work / f"{name}-{machine.id}"
    settings = {"ROOT": folder / "root", "CELL": "default", "QMASTER_PORT": free_port(), "EXECD_PORT": free_port()}
    settings["ND"] = "1"  # daemons stay in the foreground
    environment = ("env", *(f"SGE_{key}={value}" for key, value in settings.items()))
    grid = GridEngine(machine, folder, environment, len(os.sched_getaffinity(0)))
    _make_cell(grid)
    _start_daemons(grid)
    return grid


def _make_cell(grid: GridEngine) -> None:
    """Make the files and the database that an installation begins with."""
    root = grid.folder / "root"
    common = root / "default" / "common"
    for each in (common, root / "spool", root / "qmaster" / "job_scripts", root / "execd"):
        each.mkdir(parents=True)
    (root / "util").symlink_to(SHARED / "util")
    (common / "bootstrap").write_text(BOOTSTRAP.format(root=root, library=LIBRARY), "utf-8")
    host = socket.gethostname()
    (common / "act_qmaster").write_text(f"{host}\n", "utf-8")
    # Where this machine's name is an address of the loopback interface, that address is called localhost.
    (common / "host_aliases").write_text(f"{host} localhost\n", "utf-8")
    lines = [line.split() for line in (SHARED / "default-configuration").read_text("utf-8").splitlines()]
    words = {line[0]: " ".join(line[1:]) for line in lines if line and not line[0].startswith("#")}
    words |= {key: value.format(root=root) for key, value in CONFIGURATION.items()}
    configuration = _write(grid.folder / "configuration", words)
    grid(f"{LIBRARY}/spoolinit", "berkeleydb", "libspoolb", str(root / "spool"), "init")
    grid(f"{LIBRARY}/spooldefaults", "configuration", configuration)
    grid(f"{LIBRARY}/spooldefaults", "complexes", str(SHARED / "util" / "resources" / "centry"))
    grid(f"{LIBRARY}/spooldefaults", "usersets", str(SHARED / "util" / "resources" / "usersets"))
    grid(f"{LIBRARY}/spooldefaults", "managers", "root")


def _start_daemons(grid: GridEngine) -> None:
    host = socket.gethostname()
    grid.machine.start("sge_qmaster", *grid.environment, "sge_qmaster")
    asking = (*grid.environment, "qconf", "-sh")
    wait_until("the master answers", lambda: grid.machine.run(*asking, check=False).returncode == 0)
    grid("qconf", "-as", host)
    grid("qconf", "-Ap", _write(grid.folder / "parallel", PARALLEL))
    queue = {key: value.format(host=host, cores=grid.cores) for key, value in QUEUE.items()}
    grid("qconf", "-Aq", _write(grid.folder / "queue", queue))
    grid.machine.start("sge_execd", *grid.environment, "sge_execd")
    wait_until("the node reports", lambda: "lx-" in grid("qstat", "-f"))


def _write(file: Path, words: dict[str, str]) -> str:
    file.write_text("".join(f"{key} {value}\n" for key, value in words.items()), "utf-8")
    return str(file)
