"""Systems of which a part is given: their true equations, what a user would give, and what is measured."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

Range = tuple[float, float]


@dataclass(frozen=True)
class TemplateSystem:
    """A system and a job for it.

    `truths` are the right-hand sides with numbers by state, `given` the sides that a user gives. `parameters` are the
    bounds of the parameters, `values` their true values. `rests` are the true unknown parts by label. `hidden` states
    have no column; `observed` columns are expressions of states, and `observed_truths` the same with numbers. `initial`
    are bounds on initial values or given values. `starts` are initial states of trajectories that are measured at
    `rows` times up to `duration`. Parameters `by_run` are states with the rate 0, whose initial values differ.
    """

    truths: Mapping[str, str]
    given: Mapping[str, str]
    starts: tuple[tuple[float, ...], ...]
    duration: float
    rows: int
    parameters: Mapping[str, Range] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    rests: Mapping[str, str] = field(default_factory=dict)
    hidden: tuple[str, ...] = ()
    observed: Mapping[str, str] = field(default_factory=dict)
    observed_truths: Mapping[str, str] = field(default_factory=dict)
    initial: Mapping[str, float | Range] = field(default_factory=dict)
    by_run: tuple[str, ...] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of all states."""
        return tuple(self.truths)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the measured columns."""
        return (*(state for state in self.states if state not in (*self.hidden, *self.by_run)), *self.observed)

    @property
    def known(self) -> dict[str, float]:
        """The true values of all parameters; ``l[2]`` is the value of l in the second trajectory."""
        of_runs = {
            f"{name}[{number}]": start[self.states.index(name)]
            for name in self.by_run
            for number, start in enumerate(self.starts, start=1)
        }
        return {**self.values, **of_runs}


SYSTEMS: Final[Mapping[str, TemplateSystem]] = {
    "pendulum": TemplateSystem(
        truths={"theta": "v", "v": "-9.81/1.3*sin(theta) - 0.25*v*abs(v)"},
        given={"theta": "v", "v": "-9.81/l*sin(theta) + ?(v)"},
        starts=((2.0, 0.0),), duration=12.0, rows=240,
        parameters={"l": (0.1, 10.0)}, values={"l": 1.3}, rests={"?": "-0.25*v*abs(v)"},
    ),
    "pendulum, length by run": TemplateSystem(
        truths={"theta": "v", "v": "-9.81/l*sin(theta) - 0.25*v*abs(v)", "l": "0"},
        given={"theta": "v", "v": "-9.81/l*sin(theta) + ?"},
        starts=((2.0, 0.0, 0.5), (2.0, 0.0, 1.3), (2.0, 0.0, 2.5)), duration=6.0, rows=120,
        parameters={"l": (0.1, 10.0)}, by_run=("l",), rests={"?": "-0.25*v*abs(v)"},
    ),
    "bioreactor": TemplateSystem(
        truths={"X": "0.5*S/(0.3 + S)*X - 0.2*X", "S": "-0.5*S/(0.3 + S)*X/0.6 + 0.2*(3.0 - S)"},
        given={"X": "?1(S)*X - 0.2*X", "S": "-?1(S)*X/Y + 0.2*(3 - S)"},
        starts=((0.1, 3.0), (0.5, 0.5), (0.2, 1.5)), duration=25.0, rows=80,
        parameters={"Y": (0.1, 2.0)}, values={"Y": 0.6}, rests={"?1": "0.5*S/(0.3 + S)"},
    ),
    "two compartments": TemplateSystem(
        truths={"c": "-0.3*c - 0.5*c + 0.25*p", "p": "0.5*c - 0.25*p"},
        given={"c": "-k10*c - k12*c + k21*p", "p": "k12*c - k21*p"},
        starts=((10.0, 0.0),), duration=24.0, rows=70,
        parameters={"k10": (0.01, 10.0), "k12": (0.01, 10.0), "k21": (0.01, 10.0), "V": (0.5, 10.0)},
        values={"k10": 0.3, "k12": 0.5, "k21": 0.25, "V": 2.0},
        hidden=("c", "p"), observed={"y": "c/V"}, observed_truths={"y": "c/2.0"}, initial={"c": 10.0, "p": 0.0},
    ),
    "SEIR from I": TemplateSystem(
        truths={"S": "-0.6*S*I", "E": "0.6*S*I - 0.3*E", "I": "0.3*E - 0.2*I"},
        given={"S": "-beta*S*I", "E": "beta*S*I - sigma*E", "I": "sigma*E - gamma*I"},
        starts=((0.99, 0.008, 0.002),), duration=100.0, rows=120,
        parameters={"beta": (0.05, 5.0), "sigma": (0.02, 2.0), "gamma": (0.02, 2.0)},
        values={"beta": 0.6, "sigma": 0.3, "gamma": 0.2},
        hidden=("S", "E"), initial={"S": 0.99, "E": (0.0, 0.05)},
    ),
    "FitzHugh-Nagumo from v": TemplateSystem(
        truths={"v": "v - v**3/3 - w + 0.5", "w": "0.08*(v + 0.7 - 0.8*w)"},
        given={"v": "v - v**3/3 - w + 0.5", "w": "eps*(v + a - b*w)"},
        starts=((-1.0, 1.0),), duration=150.0, rows=300,
        parameters={"eps": (0.005, 1.0), "a": (0.05, 5.0), "b": (0.05, 5.0)},
        values={"eps": 0.08, "a": 0.7, "b": 0.8}, hidden=("w",), initial={"w": (-2.0, 2.0)},
    ),
    "Lorenz from x": TemplateSystem(
        truths={"x": "10*(y - x)", "y": "x*(28 - z) - y", "z": "x*y - 2.6666666666666665*z"},
        given={"x": "sigma*(y - x)", "y": "x*(rho - z) - y", "z": "x*y - beta*z"},
        starts=((-8.0, 8.0, 27.0),), duration=4.0, rows=400,
        parameters={"sigma": (1.0, 40.0), "rho": (5.0, 100.0), "beta": (0.3, 10.0)},
        values={"sigma": 10.0, "rho": 28.0, "beta": 8.0 / 3.0},
        hidden=("y", "z"), initial={"y": (-30.0, 30.0), "z": (0.0, 50.0)},
    ),
    "pendulum from its angle": TemplateSystem(
        truths={"theta": "v", "v": "-9.81/1.3*sin(theta) - 0.4*v*abs(v)"},
        given={"theta": "v", "v": "-9.81/l*sin(theta) + ?(v)"},
        starts=((2.0, 0.0), (1.0, 2.0)), duration=15.0, rows=300,
        parameters={"l": (0.1, 10.0)}, values={"l": 1.3}, rests={"?": "-0.4*v*abs(v)"},
        hidden=("v",), initial={"v": (-5.0, 5.0)},
    ),
    "van der Pol from x": TemplateSystem(
        truths={"x": "v", "v": "1.2*(1 - x**2)*v - x"},
        given={"x": "v", "v": "-k*x + ?(x,v)"},
        starts=((0.5, 0.0), (2.5, 1.0)), duration=15.0, rows=300,
        parameters={"k": (0.1, 10.0)}, values={"k": 1.0}, rests={"?": "1.2*(1 - x**2)*v"},
        hidden=("v",), initial={"v": (-5.0, 5.0)},
    ),
    "bioreactor from X": TemplateSystem(
        truths={"X": "(1.2*S/(0.4 + S) - 0.3)*X", "S": "0.3*(3 - S) - 1.2*S/(0.4 + S)*X/0.5"},
        given={"X": "(?1(S) - 0.3)*X", "S": "0.3*(3 - S) - ?1(S)*X/0.5"},
        starts=((0.1, 2.5), (0.05, 0.5)), duration=15.0, rows=300, rests={"?1": "1.2*S/(0.4 + S)"},
        hidden=("S",), initial={"S": (0.0, 5.0)},
    ),
    "prey from its predator": TemplateSystem(
        truths={"N": "N*(1 - N/6) - N/(1 + 0.5*N)*P", "P": "0.5*N/(1 + 0.5*N)*P - 0.4*P"},
        given={"N": "N*(1 - N/6) - ?1(N)*P", "P": "0.5*?1(N)*P - 0.4*P"},
        starts=((2.0, 1.0), (4.0, 0.5)), duration=15.0, rows=300, rests={"?1": "N/(1 + 0.5*N)"},
        hidden=("N",), initial={"N": (0.1, 10.0)},
    ),
}  # fmt: skip
