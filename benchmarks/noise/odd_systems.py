"""The seven systems of Table III with constants that are no simple numbers, unwritten ones included.

The paper's constants are 1, 2, 1/2 and the like, which a program that favours simple numbers gets right to the last
digit. Each constant here is the paper's times an irregular factor between 0.97 and 1.03, so that what is said of its
error is put to the test.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from benchmarks.harness.systems import SYSTEMS, System


def _respiration(x: float, y: float) -> tuple[float, float]:
    eaten = x * y / (1 + 0.507 * x * x)
    return 20.26 - 0.987 * x - 1.013 * eaten, 9.87 - 1.021 * eaten


def _prey(x: float, y: float) -> tuple[float, float]:
    share = x / (1.021 + x)
    return 4.052 * x - 0.987 * x * x - 1.013 * share * y, 0.983 * share * y - 0.0759 * y * y


ODD: Final[dict[str, System]] = {
    "glider": replace(
        SYSTEMS["glider"],
        truth={"v": "-0.0507*v**2 - 0.987*sin(theta)", "theta": "1.013*v - 0.976*cos(theta)/v"},
        field=lambda v, a: (-0.0507 * v * v - 0.987 * np.sin(a), 1.013 * v - 0.976 * np.cos(a) / v),
    ),
    "bacterial_respiration": replace(
        SYSTEMS["bacterial_respiration"],
        truth={
            "x": "20.26 - 0.987*x - 1.013*x*y/(1 + 0.507*x**2)",
            "y": "9.87 - 1.021*x*y/(1 + 0.507*x**2)",
        },
        field=_respiration,
    ),
    "predator_prey": replace(
        SYSTEMS["predator_prey"],
        truth={
            "x": "4.052*x - 0.987*x**2 - 1.013*x*y/(1.021 + x)",
            "y": "0.983*x*y/(1.021 + x) - 0.0759*y**2",
        },
        field=_prey,
    ),
    "bar_magnets": replace(
        SYSTEMS["bar_magnets"],
        truth={
            "theta1": "0.5065*sin(theta1 - theta2) - 0.987*sin(theta1)",
            "theta2": "0.4935*sin(theta2 - theta1) - 1.013*sin(theta2)",
        },
        field=lambda a, b: (
            0.5065 * np.sin(a - b) - 0.987 * np.sin(a),
            0.4935 * np.sin(b - a) - 1.013 * np.sin(b),
        ),
    ),
    "shear_flow": replace(
        SYSTEMS["shear_flow"],
        truth={
            "theta": "1.013*cot(phi)*cos(theta)",
            "phi": "(0.987*cos(phi)**2 + 0.1013*sin(phi)**2)*sin(theta)",
        },
        field=lambda a, p: (
            1.013 * np.cos(a) / np.tan(p),
            (0.987 * np.cos(p) ** 2 + 0.1013 * np.sin(p) ** 2) * np.sin(a),
        ),
    ),
    "van_der_pol": replace(
        SYSTEMS["van_der_pol"],
        truth={"x": "10.13*y + 9.87*x - 3.38*x**3", "y": "-0.1021*x"},
        field=lambda x, y: (10.13 * y + 9.87 * x - 3.38 * x**3, -0.1021 * x),
    ),
    "lotka_volterra": replace(
        SYSTEMS["lotka_volterra"],
        truth={"x": "3.039*x - 1.974*x*y - 1.013*x**2", "y": "2.026*y - 0.987*x*y - 1.021*y**2"},
        field=lambda x, y: (3.039 * x - 1.974 * x * y - 1.013 * x * x, 2.026 * y - 0.987 * x * y - 1.021 * y * y),
    ),
}
"""By name, in the order of Table III."""
