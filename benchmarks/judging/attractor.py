"""How often the test for an attractor refuses the truth, and how often it notices another attractor.

``python -m benchmarks.judging.attractor --rows 2000 6000 10000 40000 --draws 200`` measures Lorenz's system without
noise from random initial states on the attractor, 0.01 apart (0.9 e-folds of an error in a hundred rows), looks at the
true equations and at those with 26 in place of 28, and prints what share of the draws is refused. Of the truth that is
to be a hundredth, `InferenceSettings.improbable`.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator
from typing import Final

import numpy as np

from atoll.terminal.output import say
from atoll_coordinator.model.inference.attractor import along, look_for_chaos
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.system import System, system_of
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.command_line import option, program, whole

STEP: Final = 0.01
RATE: Final = 0.9
PIECE: Final = 50
TOLERANCE: Final = 1e-8
NAMES: Final = ("x", "y", "z")


def lorenz(rayleigh: float) -> System:
    """Return Lorenz's system, none of its constants to be fitted."""
    texts = ("10*(y - x)", f"{rayleigh}*x - x*z - y", "x*y - 2.6666666666666665*z")
    return system_of([from_infix(text, NAMES) for text in texts], NAMES, NAMES).with_fixed_constants()


def measured(rows: int, generator: np.random.Generator) -> Measurements:
    """Return so many rows of one trajectory on the attractor, as if each was measured exactly."""
    times = STEP * np.arange(float(1000 + rows))
    box = np.array([[-20.0, 20.0], [-25.0, 25.0], [5.0, 45.0]])
    simulated = along(_blank(box[:, :1], box[:, 1:]), times, TOLERANCE, len(times)).simulate(
        lorenz(28.0), generator.uniform(-5.0, 5.0, 3) + np.array([0.0, 0.0, 25.0])
    )
    assert not isinstance(simulated, str)
    return _along_pieces(np.ascontiguousarray(simulated[:, 1000:]))


def _blank(low: FloatArray, high: FloatArray) -> Measurements:
    return _along_pieces(np.concatenate([low, high], axis=1))


def _along_pieces(states: FloatArray) -> Measurements:
    count, rows = states.shape
    cuts = np.append(np.arange(0, rows, PIECE), rows)
    return Measurements(
        bounds=np.stack([cuts[:-1], cuts[1:]], axis=1),
        owners=np.zeros(len(cuts) - 1, np.int64),
        times=STEP * np.arange(float(rows)),
        measured=states,
        weights=np.ones_like(states),
        smoothed=states,
        observed=np.arange(count),
        inputs=states[:0],
        input_slopes=states[:0],
        scales=states.std(axis=1),
        noise=1e-9 * np.ones(count),
        offset=np.zeros(0, np.int64),
        variables=NAMES,
        names=("1",),
    )


def refused(system: System, rows: int, draws: int) -> Iterator[bool]:
    """Yield by draw whether the test refuses a system."""
    generator = np.random.default_rng([rows, 1])
    for _ in range(draws):
        its = measured(rows, generator)
        fit = MultipleShooting(its, TOLERANCE).fit(system, None, 0)
        assert fit is not None
        found = look_for_chaos(fit, RATE, TOLERANCE)
        yield found is not None and not found.is_kept


@program(
    "benchmarks.judging.attractor",
    __doc__,
    option("--rows", type=whole, nargs="+", default=[2000, 6000, 10_000, 40_000], help="of a trajectory"),
    option("--draws", type=whole, default=200, help="trajectories of each length (%(default)s)"),
)
def main(options: Namespace) -> int:
    """Do what the options ask for."""
    say("| rows | truth refused | 26 for 28 refused |\n|---|---|---|")
    for rows in options.rows:
        shares = [np.mean(list(refused(lorenz(its), rows, options.draws))) for its in (28.0, 26.0)]
        say("| " + " | ".join([str(rows), *(f"{100.0 * share:.1f} %" for share in shares)]) + " |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
