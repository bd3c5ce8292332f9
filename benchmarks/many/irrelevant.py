"""What an equation costs beside states that do not matter to it: Lorenz 96 with five states and k of oscillators.

Everything in one process: data prepared, variables screened, laws by regression of the five equations, and refining
of all, begun with constants in place of what a search finds.
"""

import time
from argparse import Namespace
from dataclasses import replace

import numpy as np

from atoll.terminal.output import note, say, table
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.refinement import Pool
from atoll_coordinator.model.sparse.product_laws import find_all_laws
from atoll_coordinator.model.sparse.rates.screening import with_screened_variables
from atoll_core.config import PRESETS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.pareto import FrontEntry
from benchmarks.harness.systems import table_of
from benchmarks.judging.forms import judge_form
from benchmarks.many.systems import System, lorenz96, sampled


def run(options: Namespace) -> None:
    """Print for each number of other states and each seed what the equations took, in processor seconds."""
    rows = [_measured(count, seed) for count in options.others for seed in options.seeds]
    say(table(("others", "seed", "right", "laws: s an equation", "refining: s", "s an equation"), rows))


def beside(count: int) -> System:
    """Return Lorenz 96 with five states beside `count` states of independent oscillators, an even number."""
    core, equations = lorenz96(5), dict(lorenz96(5).equations)
    for place in range(count // 2):
        rate = 1.0 + 0.37 * place
        equations |= {f"u{place}": f"{rate:g}*v{place}", f"v{place}": f"-{rate:g}*u{place}"}

    def draw(generator: np.random.Generator, number: int) -> FloatArray:
        return np.concatenate([core.draw(generator, number), generator.normal(size=count)])

    return replace(core, name=f"beside-{count}", equations=equations, draw=draw)


def _measured(count: int, seed: int) -> tuple[str, ...]:
    system = beside(count)
    runs, whole = sampled(system, seed)
    columns = dict(zip(system.names, whole, strict=True))
    config = PRESETS["default"].model_copy(update={"seed": seed})
    preparation = prepare(table_of(runs), config)
    dataset = preparation.dataset

    core = tuple(lorenz96(5).equations)
    begun = time.process_time()
    config = with_screened_variables(preparation, config)
    screening = time.process_time() - begun
    begun, right = time.process_time(), 0
    sought = replace(dataset, targets=tuple(target for target in dataset.targets if target.variable in core))
    for name, laws in find_all_laws(replace(preparation, dataset=sought), config, {}).items():
        text = to_infix(laws[0].program, dataset.names) if laws else None
        right += judge_form(text, system.equations[name], columns, with_extra=False).is_right
    finding = (time.process_time() - begun) / len(core) + screening / len(system.states)

    constant: Program = from_infix("1.0", dataset.names)
    pool = Pool((FrontEntry(1, 1.0, 1.0, 0, 0, 0, constant.to_bytes()),))
    begun = time.process_time()
    refine_all(preparation, config, dict.fromkeys(dataset.variables, pool))
    refining = time.process_time() - begun
    note(f"{count} others, seed {seed}: {right} of {len(core)}, {finding:.2f} s an equation, {refining:.1f} s")
    return (
        str(count), str(seed), f"{right}/{len(core)}", f"{finding:.2f}", f"{refining:.1f}",
        f"{refining / len(system.states):.2f}",
    )  # fmt: skip
