"""Selections to begin with: one equation, fitted to simulated trajectories, and no other candidates."""

import numpy as np

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.selection.candidates import collect_candidates
from atoll_coordinator.model.selection.model_selection import STAGES, Choice
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_core.config import JobConfig
from tests.unit.coordinator.model.shooting.made import pools, table

DEFAULT = JobConfig()
TIMES = 0.06 * np.arange(50.0)


STARTS = ([4.0], [1.0], [0.05])


def selected(known, text, noise=0.0, config=DEFAULT, starts=STARTS):
    """Return what is selected when the equation `text` is all that there is."""
    prepared = prepare(table(known, starts, TIMES, noise, 150), config)
    candidates = collect_candidates(prepared.dataset, config, pools(prepared, h=(text,)))
    task = ModellingTask(prepared.dataset, prepared.recording, config, candidates)
    comparison = task.make_comparison(task.compared_measurements, task.variables)
    model = comparison.fit_model([candidates["h"].front[0].program])
    return SelectedModel(task, *comparison.calibrate(model))


def looked_again(name, selection):
    """Return the selection after a stage of the table, as it is where that is not due."""
    stage = next(stage for stage in STAGES if stage.name == name)
    choice = Choice(selection.task, selection=selection, is_searched=True)
    return stage.run(choice).selection if stage.is_due(choice) else selection
