"""Known equations, measured on the data: they stand beside what is found. Pure."""

from common.config import JobConfig
from common.dataset import Dataset
from common.pareto import FrontEntry
from coordinator.data.prior import known_programs
from coordinator.model.errors import errors_on


def known_entries(dataset: Dataset, config: JobConfig) -> dict[str, FrontEntry]:
    """Return each known equation as the only member of its front, in the dataset's order; `config` is resolved.

    Its errors are those on all rows, infinite where it is not finite on all of them; it was found nowhere.
    """
    found = {}
    for name, program in known_programs(dataset, config).items():
        error, mse = errors_on(dataset.problem(name), program, config.evolution.loss)
        found[name] = FrontEntry(len(program), error, mse, 0, 0, 0, program.to_bytes())
    return found
