"""Evolution of fitness predictors (Schmidt & Lipson, section 2.3 and Table II of the 2008 paper).

A predictor is a list of row indices; it predicts a loss from these rows only. Its quality is the mean difference of
predicted and exact loss over the trainers. The losses of the trainers at every row are stored, so that the quality of a
new predictor needs no further evaluation.
"""

import numpy as np

from atoll_core.compilation.jit import inlined, kernel
from atoll_core.expression.kernels.tape import Int
from atoll_island_worker.evolution.kernels.random import Stream, below, uniform
from atoll_island_worker.evolution.structures import Coevolution, Ints

INFINITY = np.inf
_ROW_MUTATION = 0.05


@inlined
def judge(coevolution: Coevolution, relative: Int, rows: Ints) -> float:
    """Return the mean absolute difference of predicted and exact loss over the trainers with a finite exact loss.

    With `relative` 1 each difference is divided by the exact loss, so that no trainer outweighs the others.
    """
    total = 0.0
    finite = 0
    for t in range(coevolution.exact.shape[0]):
        if not np.isfinite(coevolution.exact[t]):
            continue
        loss = 0.0
        for r in rows:
            loss += coevolution.losses[t, r]
        difference = abs(loss / rows.shape[0] - coevolution.exact[t])
        total += difference / coevolution.exact[t] if relative == 1 and difference > 0.0 else difference
        finite += 1
    return total / finite if finite > 0 else INFINITY


@kernel
def judge_all(coevolution: Coevolution, relative: Int) -> bool:
    """Compute the quality of every predictor and choose the best one; return whether it is another one than before.

    If several are equally good, the present best one stays.
    """
    best = coevolution.best[0]
    for k in range(coevolution.quality.shape[0]):
        coevolution.quality[k] = judge(coevolution, relative, coevolution.predictors[k])
    for k in range(coevolution.quality.shape[0]):
        if coevolution.quality[k] < coevolution.quality[best]:
            best = k
    changed = bool(best != coevolution.best[0])
    coevolution.best[0] = best
    return changed


@inlined
def _shared(one: Ints, two: Ints) -> int:
    same = 0
    for k in range(one.shape[0]):
        if one[k] == two[k]:
            same += 1
    return same


@inlined
def predictor_generation(coevolution: Coevolution, relative: Int, rows: Int, children: Ints, stream: Stream) -> bool:
    """Cross and mutate two predictors; each child replaces its more similar parent if its quality is no worse.

    Returns True if the best predictor, whose rows measure the solutions, has changed.
    """
    number = coevolution.quality.shape[0]
    size = coevolution.predictors.shape[1]
    first = below(stream, number)
    second = (first + 1 + below(stream, number - 1)) % number
    cut = 1 + below(stream, size - 1)
    for k in range(size):
        a = coevolution.predictors[first, k]
        b = coevolution.predictors[second, k]
        children[0, k] = a if k < cut else b
        children[1, k] = b if k < cut else a
    for q in range(2):
        for k in range(size):
            if uniform(stream) < _ROW_MUTATION:
                children[q, k] = below(stream, rows)
    straight = _shared(children[0], coevolution.predictors[first]) + _shared(
        children[1], coevolution.predictors[second]
    )
    crossed = _shared(children[0], coevolution.predictors[second]) + _shared(children[1], coevolution.predictors[first])
    changed = False
    for q in range(2):
        parent = first if (q == 0) == (straight >= crossed) else second
        quality = judge(coevolution, relative, children[q])
        if quality <= coevolution.quality[parent]:
            same = _shared(children[q], coevolution.predictors[parent]) == size
            for k in range(size):
                coevolution.predictors[parent, k] = children[q, k]
            coevolution.quality[parent] = quality
            if parent == coevolution.best[0] and not same:
                changed = True
            elif quality < coevolution.quality[coevolution.best[0]]:
                coevolution.best[0] = parent
                changed = True
    coevolution.clock[0] += 1
    return changed
