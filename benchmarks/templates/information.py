"""What the rows of the glycolysis benchmark say about its frequency, by their Fisher information at the truth.

The measured rows have the information ``F = sum of s s^T / e^2`` about the logarithms of the thirteen numbers, with the
sensitivities s of N2 and A3 at the given times and the error e of a measured value. The standard deviation of the
logarithm of the frequency is then at least ``sqrt(g^T F^-1 g)`` for unbiased estimates (Cramér and Rao), with the
derivatives g of this logarithm. With what the bounds say beforehand (a uniform distribution of the logarithm, as the
normal distribution of equal variance), its inverse variances are added to F. The initial states are given, as in the
benchmark. Estimates count as normally distributed about the truth.

Letters: P numbers, n times.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from benchmarks.harness.tables import markdown
from benchmarks.templates import glycolysis
from benchmarks.templates.glycolysis import BOUNDS, END, LAST_GIVEN, REST, RIGHT, STATES, VALUES

_STEP: Final = 1e-3
"""Step of a logarithm in differences: its square, and the error of the integration over it, are below 1e-4."""
_TIMES: Final = np.linspace(0.0, END, 20_001)
_DRAWS: Final = 5
_MOST: Final = 3
"""Right draws of five that make a cell right: six of ten."""


def table_of_information(points: Sequence[int], noise: Sequence[int]) -> str:
    """Return the table, in Markdown: the least standard deviation of the frequency, and the share of right draws."""
    truth = {**VALUES, "rest": REST}
    states = glycolysis.states_with(truth, _TIMES)
    sensitivities, slopes = _sensitivities(truth)
    priors = np.array([12.0 / math.log(BOUNDS[name][1] / BOUNDS[name][0]) ** 2 for name in VALUES] + [0.0])
    rows, expected = [], np.zeros((2, 2))
    for count in points:
        times = np.linspace(0.0, END, count)
        given = times[times <= LAST_GIVEN]
        at_rows = np.array([[np.interp(given, _TIMES, one) for one in of_number.T] for of_number in sensitivities])
        means = [np.interp(times, _TIMES, states[:, STATES.index(name)]).mean() for name in ("N2", "A3")]
        for percent in noise:
            information = sum(
                at_rows[:, place] @ at_rows[:, place].T / (0.01 * percent * mean) ** 2
                for place, mean in enumerate(means)
            )
            cells = [str(count), f"{percent} %"]
            for place, prior in enumerate((0.0 * priors, priors)):
                deviation = math.sqrt(slopes @ np.linalg.solve(information + np.diag(prior), slopes))
                share = math.erf(RIGHT / deviation / math.sqrt(2.0))
                expected[place] += share, _share_of_cells(share)
                cells += [f"{100.0 * deviation:.1f} %", f"{share:.2f}"]
            rows.append(tuple(cells))
    draws, right = len(rows) * _DRAWS, expected * [_DRAWS, 1]
    titles = ("points", "noise", "deviation", "right", "deviation with bounds", "right with bounds")
    return "\n\n".join([
        markdown(titles, rows),
        f"expected of {draws} draws: {right[0, 0]:.0f} right, with bounds {right[1, 0]:.0f}; of {len(rows)} cells "
        f"with six of ten right: {right[0, 1]:.1f}, with bounds {right[1, 1]:.1f}",
    ])  # fmt: skip


def _share_of_cells(share: float) -> float:
    """Return the probability that at least three of five draws are right."""
    return sum(
        math.comb(_DRAWS, right) * share**right * (1.0 - share) ** (_DRAWS - right)
        for right in range(_MOST, _DRAWS + 1)
    )


def _sensitivities(truth: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives (P, n, 2) of N2 and A3, and those (P,) of the logarithm of the frequency, by the
    logarithms of the numbers."""
    of_states, of_frequency = list[FloatArray](), list[float]()
    for name in truth:
        ends = [
            glycolysis.states_with({**truth, name: truth[name] * math.exp(step)}, _TIMES) for step in (_STEP, -_STEP)
        ]
        measured = [end[:, [STATES.index("N2"), STATES.index("A3")]] for end in ends]
        of_states.append((measured[0] - measured[1]) / (2.0 * _STEP))
        periods = [glycolysis.period(_TIMES[_TIMES > LAST_GIVEN], end[_TIMES > LAST_GIVEN, 1]) for end in measured]
        up, down = (math.log(one) for one in periods if one is not None)
        of_frequency.append((down - up) / (2.0 * _STEP))
    return np.array(of_states), np.array(of_frequency)
