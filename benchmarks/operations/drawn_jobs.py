"""Jobs drawn from a seed: a table made of structure, options for it, and what a search may have found."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from atoll_coordinator.model.pools import Pool
from atoll_coordinator.tasks.preparing import Prepared
from atoll_core.config import PRESETS, Angle, DataConfig, JobConfig, ParameterConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.pareto import FrontEntry
from benchmarks.harness.jobs import table_of_columns

ROWS: Final = (4, *(5, 6, 8, 12, 20, 20, 40, 40, 60, 60, 100, 120, 120, 240) * 3)
SIZES: Final = (*[1.0] * 40, *(-1e-5, 1e-12, 1e12, 1e-30, 1e30) * 2, 1e-100, 1e100, 1e-160, 1e160, 1e300)
UNFIT: Final = 0.03
"""Share of the cases whose options are drawn without a look at the table and at each other; most are refused."""
PROCESSES: Final = 1 / 8
"""Share of the tables whose columns are paths of processes."""
STOCHASTIC: Final = 2 / 3
"""Share of the cases that seek a process, of those whose table admits it."""
PATH_ROWS: Final = (110, 120, 150, 200, 240, 400)
LEAST_STEPS: Final = 102
"""That a process takes, and those that are lost where trajectories begin."""
NO_PROCESS: Final = frozenset(("robust", "weights", "offsets", "group", "per_trajectory"))
"""Options that mean nothing where noise is part of the law."""
GIVEN: Final = 0.25
"""Share of the cases with given equations, of those whose other options admit them."""
NO_TEMPLATE: Final = frozenset(("target", "derivatives", "stochastic", "group", "per_trajectory"))
"""Options that exclude given equations."""
SIDES: Final = (
    "-k*{x} + ?", "?*{x}", "{x}/(k + ?)", "?1 - {y}", "c*{x} - ?1", "exp(-?) - k", "k - c*{x}", "k*{y} + ?({x})",
    "?1*{x}", "k*sin(c*{x}) + 2*?({y})",
)  # fmt: skip

FRONTS: Final = ("{x}", "{x} + 1", "0.5", "{x}*{y}", "1/{x}", "sin({x})", "{x}*{x} - {y}", "{x}/({y} - {y})")


def column(draw: np.random.Generator, times: FloatArray, others: Sequence[FloatArray]) -> FloatArray:
    """Return a column made of structure: a constant, a ramp, a period, steps, ties, another column, or noise."""
    rows, phases = len(times), np.arange(len(times))
    period = int(draw.integers(2, 21))
    kinds: list[Callable[[], ArrayLike]] = [
        lambda: np.full(rows, float(draw.choice([0.0, 1.0, -7.5]))),
        lambda: draw.integers(-5, 6) * phases + float(draw.integers(0, 3)),
        lambda: np.cos(2.0 * np.pi * phases / period),
        lambda: -np.sin(2.0 * np.pi * phases / period),
        lambda: np.exp(-0.1 * phases),
        lambda: 2.0 ** (phases % 60),
        lambda: 1.0 * (phases % 2),
        lambda: np.floor(phases / period),
        lambda: np.where(phases < rows // 2, 1.0, np.exp(-0.3 * np.maximum(phases - rows // 2, 0))),
        lambda: 1.0 * phases * phases,
        lambda: np.round(draw.normal(size=rows), int(draw.integers(0, 3))),
        lambda: draw.normal(size=rows),
        lambda: np.cumsum(draw.normal(size=rows)),
        lambda: np.tanh(0.3 * (phases - rows / 2)),
        lambda: np.cos(0.3 * phases) + 0.01 * draw.normal(size=rows),
        lambda: (0.7 * phases) % (2.0 * np.pi),
        lambda: 1.0 / (1.0 + phases),
        lambda: times + 0.0,
    ]
    if others:
        kinds += [
            lambda: others[-1] + 0.0,
            lambda: 2.0 * others[-1],
            lambda: 1.0 - others[0],
            lambda: 1.0 - np.sum(others, axis=0),
            lambda: np.gradient(others[0]),
        ] * 2
    return np.asarray(kinds[int(draw.integers(len(kinds)))](), dtype=np.float64)


def path(draw: np.random.Generator, times: FloatArray, others: Sequence[FloatArray]) -> FloatArray:
    """Return a path of a process: a walk, one that is drawn back, grows, or is driven by another column, or noise."""
    rows = len(times)
    noise = draw.normal(size=rows) * draw.choice([0.01, 0.3, 1.0])
    kinds: list[Callable[[], ArrayLike]] = [
        lambda: np.cumsum(noise),
        lambda: _drawn_back(noise, float(draw.choice([0.5, 0.9, 0.99]))),
        lambda: np.exp(np.cumsum(0.1 * noise)),
        lambda: np.cos(0.3 * np.arange(rows) + np.cumsum(0.1 * noise)),
        lambda: np.cumsum(draw.poisson(0.5, rows) - 0.5),
        lambda: np.cumsum(noise * (1.0 + np.tanh(np.cumsum(noise)))),
        lambda: 3.0 + noise,
    ]
    if others:
        kinds += [lambda: np.cumsum(0.1 * others[-1] + noise), lambda: others[0] + noise]
    return np.asarray(kinds[int(draw.integers(len(kinds)))](), dtype=np.float64)


def _drawn_back(noise: FloatArray, kept: float) -> FloatArray:
    """Return the walk that keeps such a share of where it is at each step."""
    from scipy.signal import lfilter  # whose import takes half a second

    return np.asarray(lfilter([1.0], [1.0, -kept], noise))


def table_of(draw: np.random.Generator) -> Table:
    """Return a table: times, some columns, one that counts runs, one of weights; perhaps ties, zeros, holes."""
    is_process = bool(draw.uniform() < PROCESSES)
    rows = int(draw.choice(PATH_ROWS if is_process else ROWS))
    drawn = path if is_process else column
    steps = [np.ones(rows), draw.uniform(0.1, 3.0, rows), np.where(draw.uniform(size=rows) < 0.1, 60.0, 1.0)]
    with np.errstate(all="ignore"):
        times = np.cumsum(steps[int(draw.choice([0, 0, 0, 1, 2]))]) * draw.choice([0.1, 1.0, 1e-9, 1e9])
        columns: dict[str, FloatArray] = {}
        for name in "xyz"[: int(draw.choice([1, 2, 2, 3]))]:
            columns[name] = drawn(draw, times, [*columns.values()])
        for name, values in columns.items():
            columns[name] = _spoilt(draw, values) * draw.choice(SIZES)
    runs = np.repeat([1.0, 2.0], [rows // 2, rows - rows // 2])
    whole = {"t": times, **columns, "run": runs, "w": draw.choice([0.0, 0.5, 1.0, 1.0, 1e6], rows)}
    starts = (0, rows // 2) if draw.uniform() < 0.2 and rows > 11 else (0,)
    units = {"x": "m", "t": "s", "y": "m/s"} if draw.uniform() < 0.2 else {}
    table = table_of_columns(whole, "drawn.csv", starts)
    return replace(table, units=tuple(units.get(name, "") for name in whole))


def _spoilt(draw: np.random.Generator, values: FloatArray) -> FloatArray:
    rows, kind = len(values), int(draw.integers(12))
    if kind == 0:
        return np.repeat(values[::2], 2)[:rows]  # each row twice
    if kind == 1:
        return np.where(draw.uniform(size=rows) < 0.2, 0.0, values)
    if kind == 2:
        return np.where(draw.uniform(size=rows) < 0.1, np.nan, values)
    if kind == 3:
        return np.where(draw.uniform(size=rows) < 0.1, 100.0 * values, values)
    return values


def config_of(draw: np.random.Generator, table: Table) -> JobConfig:
    """Return options, most of which go together."""
    columns = dict(zip(table.names, table.columns, strict=True))
    named = [name for name in table.names if name in "xyz"]
    is_unfit = bool(draw.uniform() < UNFIT)
    moving = [name for name in named if is_unfit or _changes(columns[name])] or named
    some = tuple(moving[: int(draw.integers(1, len(moving) + 1))])
    fields: dict[str, Any] = {"states": some}
    rest = tuple(name for name in named if name not in some)
    if rest and draw.uniform() < 0.7:
        fields["inputs"] = rest
    is_timed = False
    if draw.uniform() < 0.1:
        fields = {"target": moving[0], "inputs": tuple(name for name in named if name != moving[0]) or ("run",)}
    elif draw.uniform() < 0.1 and len(moving) > 1:
        fields = {"states": (moving[0],), "derivatives": (moving[1],)}
    else:
        is_timed = True
        fields["order"] = int(draw.choice([1, 1, 1, 2]))
        if draw.uniform() < STOCHASTIC and fields["order"] == 1:
            noisy = _moved_by_noise({name: columns[name] for name in (*some, *fields.get("inputs", ()))}, some)
            fields |= {"states": noisy, "stochastic": True} if noisy else {}
            some = noisy or some
        if draw.uniform() < 0.15:
            fields["angles"] = (Angle(column=some[0], degrees=bool(draw.integers(2))),)
        if draw.uniform() < 0.1:
            fields["offsets"] = some[:1]
    choices: dict[str, Any] = {"robust": True, "missing": "drop", "weights": "w"}
    fields |= {name: value for name, value in choices.items() if draw.uniform() < (0.95 if name == "missing" else 0.06)}
    fields |= _parts_of(draw, len(table.starts) > 1, is_timed and table.rows > 11, is_unfit)
    if "stochastic" in fields:
        fields = {name: value for name, value in fields.items() if name not in NO_PROCESS}
    preset = PRESETS["paper" if draw.uniform() < 0.1 else "default"]
    operators = (("+", "-", "*", "/", "sin", "cos"), ("+", "*"), ("+", "-", "*", "/", "exp", "log", "sqrt", "pow"))
    space = preset.space.model_copy(update={"operators": operators[int(draw.choice([0, 0, 1, 2]))]})
    prior = _prior_of(draw, some, fields, is_unfit)
    update = {"seed": 1, "data": DataConfig(**fields), "space": space, "prior": preset.prior.model_copy(update=prior)}
    return preset.model_copy(update=update)


def _prior_of(
    draw: np.random.Generator, states: Sequence[str], fields: Mapping[str, Any], is_unfit: bool
) -> dict[str, Any]:
    """Return guesses, bounds and given equations."""
    prior: dict[str, Any] = {}
    if draw.uniform() < 0.1 and "target" not in fields:
        prior["guesses"] = {states[0]: (f"{states[0]}*0.3",)}
    if draw.uniform() < 0.1:
        prior["bounds"] = {"*": ("c > 0",)}
    return prior | _given_equations(draw.spawn(1)[0], states, is_unfit or not NO_TEMPLATE.intersection(fields))


def _given_equations(draw: np.random.Generator, states: Sequence[str], may_be_given: bool) -> dict[str, Any]:
    """Return given equations of some states, in a share of the cases whose other options admit them."""
    if not may_be_given or draw.uniform() >= GIVEN:
        return {}
    chosen = [name for name in states if draw.uniform() < 0.7] or list(states[:1])
    sides = {name: str(draw.choice(SIDES)).format(x=name, y=states[-1]) for name in chosen}
    bounds = {"k": ParameterConfig(lower=0.1, upper=10.0), "c": ParameterConfig(start=2.0)}
    declared = {name: one for name, one in bounds.items() if any(name in side for side in sides.values())}
    return {"equations": sides, "parameters": declared if draw.uniform() < 0.5 else {}}


def _parts_of(draw: np.random.Generator, is_cut: bool, may_differ: bool, is_unfit: bool) -> dict[str, Any]:
    """Return options about trajectories: of a table that `is_cut` into two, of which more `may_differ` than times."""
    marked = {"trajectory": "run"}
    kinds: list[dict[str, Any]] = [{"holdout": 1}, {"group": "run"}, {"per_trajectory": True}]
    if is_unfit:
        return {name: value for options in (marked, *kinds) for name, value in options.items() if draw.uniform() < 0.3}
    if not may_differ or draw.uniform() < 0.75:
        return {}
    chosen = kinds[int(draw.integers(3))] if draw.uniform() < 0.8 else {}
    return chosen | ({} if is_cut and chosen else marked)


def _moved_by_noise(columns: Mapping[str, FloatArray], states: Sequence[str]) -> tuple[str, ...]:
    """Return the states whose steps change by more than their size and can be squared; none with too few steps."""
    is_known = np.isfinite([*columns.values()]).all(axis=0)
    if is_known.sum() <= LEAST_STEPS:
        return ()
    kept = {name: columns[name][is_known] for name in states}
    steps = {name: np.diff(values) for name, values in kept.items() if 1e-60 < np.ptp(values) < 1e60}
    return tuple(name for name, step in steps.items() if np.median(abs(np.diff(step))) > np.median(abs(step)) > 0.0)


def _changes(values: FloatArray) -> bool:
    """Tell whether a column has two values and a size to compute with."""
    known = values[np.isfinite(values)]
    return len(known) > 4 and bool(np.ptp(known) > 0.0) and 1e-120 < float(np.abs(known).max()) < 1e120


def pools_of(draw: np.random.Generator, prepared: Prepared) -> dict[str, Pool]:
    """Return what a search might hand on: nothing, lines, products, poles."""
    dataset = prepared.preparation.dataset
    pools = {name: Pool((entry,), ()) for name, entry in prepared.known.items()}
    for problem in map(dataset.problem, [target.variable for target in prepared.sought]):
        chosen = draw.choice(len(FRONTS), int(draw.integers(0, 4)), replace=False)
        names = dict(zip("xy", draw.choice(dataset.names, 2), strict=True))
        programs = [from_infix(FRONTS[place].format(**names), dataset.names) for place in chosen]
        size = problem.target.standard_deviation
        front = [
            FrontEntry(1 + place, size / (1 + place), size * size / (1 + place), 0, 1, 0, program.to_bytes())
            for place, program in enumerate(programs)
        ]
        pools[problem.target.variable] = Pool(tuple(front[:2]), tuple(front[2:]))
    return pools
