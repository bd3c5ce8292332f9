"""Known equations (given by the user): their errors and missing values on the data. Pure."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from atoll_coordinator.data.prior_knowledge import known_programs
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.regression.errors import measure_errors
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset
from atoll_core.expression.evaluation import values_of
from atoll_core.search.pareto import FrontEntry


def known_entries(dataset: Dataset, config: JobConfig, parameters: Sequence[float] = ()) -> dict[str, FrontEntry]:
    """Return each known equation as the only member of its front, in the order of the dataset; `config` is resolved.

    Given equations have these values of the `parameters`, as they were estimated before refining. Errors are measured
    on all rows, and are infinite if the equation has no finite value on some row. Epoch, generation and island are 0.
    """
    entries = {}
    for name, program in known_programs(dataset, config, parameters).items():
        error, mse = measure_errors(dataset.problem(name), program, config.evolution.loss)
        entries[name] = FrontEntry(len(program), error, mse, 0, 0, 0, program.to_bytes())
    return entries


def warn_of_missing_values(preparation: Preparation, config: JobConfig) -> Preparation:
    """Return `preparation` with a warning for each known equation that has no finite value on some rows. `config` is
    resolved.

    The error of such an equation is infinite; the warning tells the user the reason.
    """
    dataset = preparation.dataset
    remarks = []
    for name, program in known_programs(dataset, config, preparation.parameters).items():
        rows = dataset.inputs.shape[1]
        failed = rows - int(np.isfinite(values_of(program, dataset.inputs)).sum())
        if failed:
            remarks.append(f"The known equation of '{name}' has no finite value on {failed} of {rows} rows.")
    return replace(preparation, dataset=replace(dataset, warnings=(*dataset.warnings, *remarks)))
