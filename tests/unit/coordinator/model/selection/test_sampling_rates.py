"""The same motion sampled more often has the same law."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.selection.candidates import collect_candidates
from atoll_coordinator.model.selection.joint_search import fit_jointly
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_core.config import DataConfig, JobConfig
from atoll_core.data.table import Table
from atoll_core.expression.program import structure
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.shooting.made import pools

LAW = "2.0*u - 0.5*q_dot - 20.0*sin(q)"
LINE = "2.0*u - 20.0*q"
STRENGTHS = (15.0, 20.0, 25.0)
OPTIONS = {"states": ("q",), "inputs": ("u",), "group": "m", "order": 2}
ROWS = 4000


def driving(t):
    return 2.0 * np.sin(3.1 * t) + np.sin(8.2 * t + 1.0)


@cache
def motion():
    """Return the angle of driven pendulums of several strengths, 4 s at 1 kHz, with noise of 0.004 rad."""
    t, rng = 1e-3 * np.arange(ROWS), np.random.default_rng(5)
    parts = []
    for place, strength in enumerate(STRENGTHS):

        def rates(at, state, strength=strength):
            return [state[1], 2.0 * driving(at) - 0.5 * state[1] - strength * np.sin(state[0])]

        run = solve_ivp(rates, (0.0, t[-1]), [0.8 - 0.5 * place, 0.0], t_eval=t, rtol=1e-9, atol=1e-10)
        parts.append(run.y[0] + 0.004 * rng.standard_normal(ROWS))
    return t, parts


def table(stride):
    t, parts = motion()
    chosen = slice(None, None, stride)
    rows = len(t[chosen])
    columns = np.array([
        np.tile(t[chosen], len(parts)),
        np.concatenate([part[chosen] for part in parts]),
        np.tile(driving(t[chosen]), len(parts)),
        np.repeat(STRENGTHS, rows),
    ])  # fmt: skip
    places = np.arange(columns.shape[1], dtype=np.int64)
    starts = tuple(range(0, columns.shape[1], rows))
    return Table(("t", "q", "u", "m"), ("",) * 4, columns, starts, ("a.csv",), 0 * places, places + 2, ())


@pytest.mark.parametrize("stride", [1, 3, 10])
def test_groups_of_pendulums_have_the_same_law_however_often_they_are_sampled(stride):
    """Along pieces of half a second a line describes a pendulum; the law needs whole swings."""
    config = JobConfig(data=DataConfig(**OPTIONS))
    preparation = prepare(table(stride), config)
    candidates = collect_candidates(preparation.dataset, config, pools(preparation, q=[LAW, LINE]))
    task = ModellingTask(preparation.dataset, preparation.recording, config, candidates)
    selection = fit_jointly(task, [candidates["q"].programs])
    assert selection is not None
    (program,) = selection.model.programs
    assert structure(program) == structure(from_infix(LAW, preparation.dataset.names))
    measurements = selection.comparison.estimator.measurements
    assert set(measurements.owners.tolist()) == {0, 1, 2}
    assert np.ptp(measurements.times) > 3.0
    system = selection.model.fit.system
    assert np.abs(system.by_place(system.values)).max(axis=1) == pytest.approx(STRENGTHS, rel=0.02)
