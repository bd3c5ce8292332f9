"""The laws of each state by regression alone: nothing is searched, nothing simulated, one core."""

import time
from argparse import Namespace

from atoll.terminal.output import note, say, table
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.sparse.laws import find_all_laws, screen_variables
from atoll_core.expression.text.infix import to_infix
from benchmarks.judging.forms import judge_form
from benchmarks.many.campaign import case, keys


def run(options: Namespace) -> None:
    """Print for each system, noise and seed how many laws have the truth's form, and the processor seconds."""
    rows = [_judged(*key, options) for key in keys(options)]
    say(table(("system", "noise %", "seed", "right", "cpu s"), rows))


def _judged(name: str, noise: float, seed: int, options: Namespace) -> tuple[str, ...]:
    searched = case(name, noise, seed, options)
    begun = time.process_time()
    preparation = prepare(searched.table, searched.config)
    assert preparation.recording is not None
    config, names = screen_variables(preparation, searched.config), preparation.dataset.names

    laws = dict(find_all_laws(preparation, config, {}))
    texts = [to_infix(laws[state][0].program, names) if laws[state] else None for state in searched.equations]
    seconds = time.process_time() - begun
    right = 0
    for text, (state, truth) in zip(texts, searched.equations.items(), strict=True):
        form = judge_form(text, truth, searched.columns, with_extra=False)
        right += form.is_right
        if not form.is_right:
            note(f"{name} seed {seed} {state}: {form.kind}: {text}")
    note(f"{name} {noise:g} % seed {seed}: {right} of {len(texts)}, {seconds:.1f} s")
    return name, f"{noise:g}", str(seed), f"{right}/{len(texts)}", f"{seconds:.1f}"
