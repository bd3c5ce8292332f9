"""Which job of a batch system this process is of: workers say so in their names, where ``coordinator adapt`` looks."""

import re
from collections.abc import Mapping
from typing import Final

_LONGEST: Final = 10
"""Digits of a job's id."""

_VARIABLES: Final[Mapping[str, tuple[str, str | None]]] = {
    "slurm": ("SLURM_JOB_ID", None),
    "pbs": ("PBS_JOBID", None),
    "lsf": ("LSB_JOBID", None),
    "sge": ("JOB_ID", "SGE_ROOT"),
}
"""The variable with the id, and one that has to be there for that to be what it says."""

_IN_NAME: Final = re.compile(rf"-(?:{'|'.join(_VARIABLES)})([0-9]+)-")


def batch_job(environment: Mapping[str, str]) -> str:
    """Return the system and the number of the job, such as ``slurm123``; "" outside of one."""
    for system, (variable, beside) in _VARIABLES.items():
        found = re.match(r"\d+", environment.get(variable, ""), re.ASCII)
        if found and len(found[0]) <= _LONGEST and (beside is None or beside in environment):
            return f"{system}{found[0]}"
    return ""


def job_of(worker: str) -> str | None:
    """Return the number of the job that a worker is of, by its name; None: of none that is known."""
    found = _IN_NAME.search(worker)
    return found[1] if found else None
