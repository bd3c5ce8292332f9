"""Systems of textbooks, as families: right-hand sides with names for their constants, and ranges of these.

Names of constants begin with ``k``; a range is (lowest, highest), drawn evenly in the logarithm. Boxes of initial
states are numbers or names of constants that a state is measured in.
"""

from dataclasses import dataclass
from typing import Final

Range = tuple[float, float]
Box = tuple[float, float, str | None]
"""Lowest and highest initial value, in units of a constant if one is named."""


@dataclass(frozen=True)
class Family:
    """Right-hand sides by state, ranges of the constants, and the box of initial states in the order of the states."""

    equations: dict[str, str]
    constants: dict[str, Range]
    box: tuple[Box, ...]


_UNIT: Final[Box] = (0.2, 3.0, None)
_CENTRED: Final[Box] = (-2.0, 2.0, None)

FAMILIES: Final[dict[str, Family]] = {
    "decay": Family({"x": "-k1*x + k2"}, {"k1": (0.1, 3.0), "k2": (0.2, 5.0)}, ((0.1, 8.0, None),)),
    "logistic": Family({"x": "k1*x*(1.0 - x/k2)"}, {"k1": (0.2, 2.0), "k2": (1.0, 200.0)}, ((0.02, 1.6, "k2"),)),
    "allee": Family(
        {"x": "k1*x*(x - k2)*(k3 - x)"},
        {"k1": (0.2, 1.0), "k2": (0.3, 1.0), "k3": (2.0, 4.0)},
        ((0.1, 5.0, None),),
    ),
    "gompertz": Family({"x": "k1*x - k2*x*log(x)"}, {"k1": (0.3, 2.0), "k2": (0.2, 1.0)}, ((0.1, 12.0, None),)),
    "harvested": Family(
        {"x": "k1*x - k2*x**2 - k3*x**2/(k4 + x**2)"},
        {"k1": (0.5, 1.5), "k2": (0.05, 0.2), "k3": (0.5, 2.0), "k4": (0.5, 2.0)},
        ((0.2, 12.0, None),),
    ),
    "michaelis": Family(
        {"x": "k1 - k2*x/(k3 + x)"}, {"k1": (0.2, 0.8), "k2": (1.0, 3.0), "k3": (0.3, 2.0)}, ((0.1, 6.0, None),)
    ),
    "tank": Family({"x": "k1 - k2*sqrt(x)"}, {"k1": (0.3, 2.0), "k2": (0.3, 2.0)}, ((0.2, 8.0, None),)),
    "growth": Family(
        {"x": "k1*x**k3 - k2*x"}, {"k1": (0.5, 2.0), "k2": (0.3, 1.0), "k3": (0.55, 0.85)}, ((0.1, 12.0, None),)
    ),
    "phase": Family({"x": "k1 - k2*sin(x)"}, {"k1": (0.3, 2.0), "k2": (0.5, 2.0)}, ((-3.0, 3.0, None),)),
    "double_well": Family({"x": "k1*x - k2*x**3"}, {"k1": (0.3, 2.0), "k2": (0.2, 2.0)}, ((-2.5, 2.5, None),)),
    "ignition": Family({"x": "k1*exp(-k2*x) - k3*x"}, {"k1": (0.5, 3.0), "k2": (0.3, 1.5), "k3": (0.1, 0.5)},
                       ((0.1, 6.0, None),)),
    "linear": Family(
        {"x": "-k1*x + k2*y", "y": "-k3*x - k4*y"},
        {"k1": (0.05, 0.5), "k2": (0.5, 3.0), "k3": (0.5, 3.0), "k4": (0.05, 0.5)},
        (_CENTRED, _CENTRED),
    ),
    "lotka_volterra": Family(
        {"x": "k1*x - k2*x*y", "y": "k3*x*y - k4*y"},
        {"k1": (0.5, 2.0), "k2": (0.2, 1.5), "k3": (0.1, 1.0), "k4": (0.3, 1.5)},
        (_UNIT, _UNIT),
    ),
    "competition": Family(
        {"x": "x*(k1 - k2*x - k3*y)", "y": "y*(k4 - k5*x - k6*y)"},
        {"k1": (1.0, 3.0), "k2": (0.5, 1.5), "k3": (0.2, 1.2), "k4": (1.0, 3.0), "k5": (0.2, 1.2), "k6": (0.5, 1.5)},
        (_UNIT, _UNIT),
    ),
    "grazing": Family(
        {"x": "k1*x*(1.0 - x/k2) - k3*x*y/(k4 + x)", "y": "k5*x*y/(k4 + x) - k6*y"},
        {"k1": (0.5, 2.0), "k2": (2.0, 8.0), "k3": (0.8, 2.0), "k4": (0.5, 2.0), "k5": (0.5, 1.5), "k6": (0.1, 0.4)},
        (_UNIT, _UNIT),
    ),
    "van_der_pol": Family(
        {"x": "y", "y": "k1*(1.0 - x**2)*y - k2*x"}, {"k1": (0.3, 2.0), "k2": (0.5, 2.0)}, (_CENTRED, _CENTRED)
    ),
    "duffing": Family(
        {"x": "y", "y": "k1*x - k2*x**3 - k3*y"},
        {"k1": (0.5, 2.0), "k2": (0.3, 2.0), "k3": (0.05, 0.5)},
        (_CENTRED, _CENTRED),
    ),
    "pendulum": Family(
        {"x": "y", "y": "-k1*sin(x) - k2*y"}, {"k1": (0.5, 10.0), "k2": (0.05, 0.6)}, (_CENTRED, _CENTRED)
    ),
    "fitzhugh": Family(
        {"x": "x - x**3/3.0 - y + k1", "y": "k2*(x + k3 - k4*y)"},
        {"k1": (0.3, 0.8), "k2": (0.05, 0.3), "k3": (0.5, 0.9), "k4": (0.5, 0.9)},
        (_CENTRED, (-1.0, 1.5, None)),
    ),
    "brusselator": Family(
        {"x": "k1 - k2*x + x**2*y", "y": "k3*x - x**2*y"},
        {"k1": (0.6, 1.5), "k2": (2.0, 4.0), "k3": (1.0, 3.0)},
        (_UNIT, _UNIT),
    ),
    "selkov": Family(
        {"x": "-x + k1*y + x**2*y", "y": "k2 - k1*y - x**2*y"}, {"k1": (0.05, 0.2), "k2": (0.4, 0.9)}, (_UNIT, _UNIT)
    ),
    "toggle": Family(
        {"x": "k1/(1.0 + y**2) - k2*x", "y": "k3/(1.0 + x**2) - k4*y"},
        {"k1": (1.5, 5.0), "k2": (0.5, 1.5), "k3": (1.5, 5.0), "k4": (0.5, 1.5)},
        (_UNIT, _UNIT),
    ),
    "epidemic": Family(
        {"x": "-k1*x*y", "y": "k1*x*y - k2*y"}, {"k1": (0.5, 3.0), "k2": (0.1, 0.6)},
        ((0.7, 2.0, None), (0.02, 0.4, None)),
    ),
    "reactor": Family(
        {"x": "k1*(k2 - x) - k3*x*exp(y)", "y": "-k4*y + k5*x*exp(y)"},
        {"k1": (0.3, 1.0), "k2": (1.0, 3.0), "k3": (0.1, 0.5), "k4": (0.5, 2.0), "k5": (0.1, 0.5)},
        (_UNIT, (0.0, 1.5, None)),
    ),
    "glider": Family(
        {"x": "-k1*x**2 - k2*sin(y)", "y": "k3*x - k4*cos(y)/x"},
        {"k1": (0.03, 0.3), "k2": (0.5, 1.5), "k3": (0.5, 1.5), "k4": (0.5, 1.5)},
        ((2.0, 6.0, None), (-1.0, 1.0, None)),
    ),
    "coupled_phases": Family(
        {"x": "k1 + k2*sin(y - x)", "y": "k3 + k4*sin(x - y)"},
        {"k1": (0.3, 2.0), "k2": (0.2, 1.5), "k3": (0.3, 2.0), "k4": (0.2, 1.5)},
        (_CENTRED, _CENTRED),
    ),
    "chemostat": Family(
        {"x": "k1*x*y/(k2 + y) - k3*x", "y": "k3*(k4 - y) - k5*x*y/(k2 + y)"},
        {"k1": (0.8, 2.0), "k2": (0.3, 1.5), "k3": (0.1, 0.4), "k4": (2.0, 5.0), "k5": (0.8, 2.5)},
        (_UNIT, _UNIT),
    ),
    "lorenz": Family(
        {"x": "k1*(y - x)", "y": "k2*x - y - x*z", "z": "x*y - k3*z"},
        {"k1": (8.0, 12.0), "k2": (20.0, 32.0), "k3": (2.0, 3.5)},
        ((-10.0, 10.0, None), (-10.0, 10.0, None), (10.0, 30.0, None)),
    ),
    "roessler": Family(
        {"x": "-y - z", "y": "x + k1*y", "z": "k2 + z*(x - k3)"},
        {"k1": (0.1, 0.25), "k2": (0.1, 0.4), "k3": (3.0, 6.0)},
        ((-4.0, 4.0, None), (-4.0, 4.0, None), (0.1, 2.0, None)),
    ),
    "food_chain": Family(
        {"x": "x*(k1 - k2*x - k3*y)", "y": "y*(k4*x - k5 - k6*z)", "z": "z*(k7*y - k8)"},
        {"k1": (1.0, 3.0), "k2": (0.1, 0.5), "k3": (0.5, 1.5), "k4": (0.5, 1.5), "k5": (0.2, 0.6), "k6": (0.5, 1.5),
         "k7": (0.5, 1.5), "k8": (0.2, 0.6)},
        (_UNIT, _UNIT, _UNIT),
    ),
    "oscillating_gene": Family(
        {"x": "k1/(1.0 + z**4) - k2*x", "y": "x - k3*y", "z": "y - k4*z"},
        {"k1": (3.0, 10.0), "k2": (0.3, 0.8), "k3": (0.3, 0.8), "k4": (0.3, 0.8)},
        (_UNIT, _UNIT, _UNIT),
    ),
    "epidemic_3": Family(
        {"x": "-k1*x*z", "y": "k1*x*z - k2*y", "z": "k2*y - k3*z"},
        {"k1": (0.8, 3.0), "k2": (0.3, 1.0), "k3": (0.1, 0.5)},
        ((0.7, 2.0, None), (0.02, 0.4, None), (0.02, 0.4, None)),
    ),
    "may_leonard": Family(
        {
            "x": "k1*x*(1.0 - x - k2*y - k3*z)",
            "y": "k1*y*(1.0 - k3*x - y - k2*z)",
            "z": "k1*z*(1.0 - k2*x - k3*y - z)",
        },
        {"k1": (0.7, 2.0), "k2": (1.1, 1.6), "k3": (0.5, 0.9)},
        ((0.1, 1.0, None), (0.1, 1.0, None), (0.1, 1.0, None)),
    ),
    "coupled_oscillators": Family(
        {"x": "y", "y": "-k1*x - k2*y + k3*(z - x)", "z": "u", "u": "-k4*z - k5*u + k3*(x - z)"},
        {"k1": (0.5, 2.0), "k2": (0.05, 0.3), "k3": (0.2, 1.0), "k4": (0.5, 2.0), "k5": (0.05, 0.3)},
        (_CENTRED, _CENTRED, _CENTRED, _CENTRED),
    ),
    "two_patches": Family(
        {
            "x": "k1*x - k2*x*y + k3*(z - x)",
            "y": "k4*x*y - k5*y",
            "z": "k6*z - k2*z*u + k3*(x - z)",
            "u": "k4*z*u - k5*u",
        },
        {"k1": (0.6, 1.6), "k2": (0.3, 1.0), "k3": (0.1, 0.4), "k4": (0.2, 0.8), "k5": (0.3, 1.0), "k6": (0.6, 1.6)},
        (_UNIT, _UNIT, _UNIT, _UNIT),
    ),
    "cascade": Family(
        {
            "x": "k1 - k2*x",
            "y": "k3*x/(k4 + x) - k5*y",
            "z": "k6*y - k7*z",
            "u": "k8*z/(1.0 + z) - k9*u",
            "v": "k10*u - k11*v",
        },
        {"k1": (0.5, 2.0), "k2": (0.2, 0.8), "k3": (1.0, 3.0), "k4": (0.5, 2.0), "k5": (0.3, 1.0), "k6": (0.5, 1.5),
         "k7": (0.3, 1.0), "k8": (1.0, 3.0), "k9": (0.3, 1.0), "k10": (0.5, 1.5), "k11": (0.3, 1.0)},
        (_UNIT, _UNIT, _UNIT, _UNIT, _UNIT),
    ),
}  # fmt: skip
"""By name."""

WITH_FUNCTIONS: Final[dict[str, Family]] = {
    **{name: FAMILIES[name] for name in ("gompertz", "tank", "growth", "ignition", "reactor")},
    "convection": Family({"x": "k1 - k2*x**k3"}, {"k1": (0.3, 2.0), "k2": (0.3, 1.0), "k3": (1.2, 1.7)},
                         ((0.1, 8.0, None),)),
    "diode": Family({"x": "k1 - k2*x - k3*exp(k4*x)"},
                    {"k1": (1.0, 3.0), "k2": (0.1, 0.5), "k3": (0.05, 0.3), "k4": (1.0, 3.0)}, ((-2.0, 2.0, None),)),
    "neuron": Family({"x": "k1 - k2*x + k3*tanh(k4*x)"},
                     {"k1": (0.1, 0.5), "k2": (0.3, 1.0), "k3": (1.0, 3.0), "k4": (0.7, 2.0)}, ((-1.5, 1.5, None),)),
    "falling": Family({"x": "k1 - k2*x*abs(x)"}, {"k1": (0.5, 3.0), "k2": (0.1, 1.0)}, ((-6.0, -1.0, None),)),
    "blackman": Family({"x": "k1 - k2*x - k3*abs(x - k4)"},
                       {"k1": (2.0, 4.0), "k2": (0.6, 1.2), "k3": (0.2, 0.5), "k4": (0.5, 1.0)}, ((-3.0, 0.2, None),)),
    "arrhenius": Family(
        {"x": "k1*(k2 - x) - k3*x*exp(-k4/y)", "y": "k1*(k5 - y) + k6*x*exp(-k4/y)"},
        {"k1": (0.3, 1.0), "k2": (1.0, 3.0), "k3": (3.0, 10.0), "k4": (1.5, 4.0), "k5": (0.5, 1.0), "k6": (3.0, 10.0)},
        (_UNIT, (0.4, 3.0, None)),
    ),
    "ivlev": Family(
        {"x": "k1*x*(1.0 - x/k2) - k3*y*(1.0 - exp(-k4*x))", "y": "k5*y*(1.0 - exp(-k4*x)) - k6*y"},
        {"k1": (0.5, 2.0), "k2": (2.0, 8.0), "k3": (0.8, 2.0), "k4": (0.4, 1.5), "k5": (0.5, 1.5), "k6": (0.1, 0.5)},
        (_UNIT, _UNIT),
    ),
    "hopfield": Family(
        {"x": "-k1*x + k2*tanh(k3*y)", "y": "-k4*y - k5*tanh(k6*x)"},
        {"k1": (0.3, 1.0), "k2": (1.0, 3.0), "k3": (0.7, 2.0), "k4": (0.3, 1.0), "k5": (1.0, 3.0), "k6": (0.7, 2.0)},
        (_CENTRED, _CENTRED),
    ),
    "tanks": Family(
        {"x": "k1 - k2*sqrt(x)", "y": "k2*sqrt(x) - k3*sqrt(y)"},
        {"k1": (0.3, 2.0), "k2": (0.5, 2.0), "k3": (0.5, 2.0)},
        ((0.2, 8.0, None), (0.2, 8.0, None)),
    ),
    "angiogenesis": Family(
        {"x": "-k1*x*log(x/y)", "y": "k2*x - k3*y*x**k4"},
        {"k1": (0.3, 1.5), "k2": (0.5, 2.0), "k3": (0.2, 0.8), "k4": (0.55, 0.8)},
        (_UNIT, _UNIT),
    ),
    "quadratic_drag": Family(
        {"x": "y", "y": "-k1*x - k2*y*abs(y)"}, {"k1": (0.5, 4.0), "k2": (0.1, 0.6)}, (_CENTRED, _CENTRED)
    ),
    "dry_friction": Family(
        {"x": "y", "y": "-k1*x - k2*y/abs(y)"}, {"k1": (0.5, 4.0), "k2": (0.05, 0.2)},
        ((3.0, 6.0, None), (3.0, 6.0, None)),
    ),
}  # fmt: skip
"""Laws with functions that a search does not begin with, by name: exp, log, sqrt, abs, tanh and powers.

They are drawn by name alone: the draws of a seed are from `FAMILIES`.
"""

NAMED: Final[dict[str, tuple[Family, dict[str, float], tuple[float, ...], float]]] = {
    "logistic": (FAMILIES["logistic"], {"k1": 0.79, "k2": 74.3}, (2.0,), 15.0),
    "linear": (FAMILIES["linear"], {"k1": 0.1, "k2": 2.0, "k3": 2.0, "k4": 0.1}, (2.0, 0.0), 15.0),
    "lotka_volterra": (FAMILIES["lotka_volterra"], {"k1": 1.1, "k2": 0.4, "k3": 0.1, "k4": 0.4}, (10.0, 5.0), 30.0),
    "van_der_pol": (FAMILIES["van_der_pol"], {"k1": 1.0, "k2": 1.0}, (0.5, 0.5), 20.0),
    "pendulum": (FAMILIES["pendulum"], {"k1": 9.81, "k2": 0.3}, (1.5, 0.0), 10.0),
    "lorenz": (FAMILIES["lorenz"], {"k1": 10.0, "k2": 28.0, "k3": 8.0 / 3.0}, (-8.0, 8.0, 27.0), 10.0),
}
"""Constants, initial state and duration of single systems, by name; one trajectory each."""
