"""The 14 Strogatz truths, each in five further forms that a search may return, and forms that are something else.

Constants carry the small errors that fitting leaves. Both rules of `benchmarks.peers.srbench` credit `EQUIVALENTS` and
refuse `OTHERS`; `UNCREDITED` and `OVERCREDITED` are forms on which they differ.
"""

from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix


def _forms(text: str) -> dict[str, tuple[str, ...]]:
    """Return by file the forms of a text, separated by semicolons."""
    parts = (line.partition(": ") for line in text.strip().replace(";\n", ";").splitlines())
    return {name: tuple(form.strip() for form in forms.split(";")) for name, _, forms in parts}


EQUIVALENTS: Final = _forms("""
glider1: -0.05*x**2 - sin(y) ; -(sin(y) + x*x*0.05) ; 0.05*(-20.0*sin(y) - x**2) ;
    -0.04999999999999*x*x - 1.0000000001*sin(y) ; sin(-y) - x*(0.05*x) ; -x*(0.05*x + sin(y)/x)
glider2: x - cos(y)/x ; (x*x - cos(y))/x ; x*(1 - cos(y)/x**2) ; -(cos(-y) - x**2)/x ;
    0.9999999999*x - 1.00000000001*cos(y)/x ; (x**3 - x*cos(y))/(x*x)
bacres1: 20 - x - x*y/(1 + 0.5*x**2) ; 20 - x - 2.0*x*y/(2.0 + x*x) ; 20 - x*(1 + y/(1 + x**2/2)) ;
    (20 - x) - y/(1/x + 0.5*x) ; ((20 - x)*(1 + 0.5*x**2) - x*y)/(0.5*x**2 + 1) ;
    20.0000000001 - 0.9999999999*x - 30.772*x*y/(30.772 + 15.386*x*x)
bacres2: 10 - x*y/(1 + 0.5*x**2) ; 10 - 30.772*x*y/(30.772 + 15.386*x*x) ; 10 - y/(1/x + x/2) ;
    -(x*y/(1 + x*x*0.5) - 10.0) ; (10 + 5*x*x - x*y)/(1 + 0.5*x**2) ;
    9.9999999999 - x*y/(1.0000000001 + 0.4999999999*x**2)
predprey1: x*(4 - x - y/(1 + x)) ; 4*x - x**2 - x*y/(1 + x) ; 4*x - x*x - 30.772*x*y/(30.772 + 30.772*x) ;
    x*(4 - x) - y + y/(x + 1) ; ((4*x - x**2)*(1 + x) - x*y)/(1 + x) ;
    x*(4.0000000001 - 0.9999999999*x - y/(1.0 + 0.99999999999*x))
predprey2: y*(x/(1 + x) - 0.075*y) ; x*y/(1 + x) - 0.075*y**2 ; y - y/(1 + x) - 0.07500000001*y*y ;
    0.075*y*(x/(0.075 + 0.075*x) - y) ; y*y*(x/(y + x*y) - 0.075) ; (x*y - 0.075*y**2*(1 + x))/(1 + x)
barmag1: 0.5*sin(x - y) - sin(x) ; -0.5*sin(y - x) - sin(x) ; 0.5*(sin(x)*cos(y) - cos(x)*sin(y)) - sin(x) ;
    sin(x)*(0.5*cos(y) - 1) - 0.5*cos(x)*sin(y) ; 0.4999999999*sin(x - y) + 1.0000000001*sin(-x) ;
    0.5*(sin(x - y) - 2*sin(x))
barmag2: 0.5*sin(y - x) - sin(y) ; -(sin(y) + 0.5*sin(x - y)) ; 0.5*sin(y)*cos(x) - 0.5*cos(y)*sin(x) - sin(y) ;
    sin(y)*(cos(x)/2 - 1) - cos(y)*sin(x)/2 ; 0.5*(sin(y - x) - sin(y) - sin(y)) ;
    -0.5000000001*(sin(x - y) + 2.0*sin(y))
shearflow1: cot(y)*cos(x) ; cos(x)*cos(y)/sin(y) ; cos(x)/tan(y) ; cos(y)/(sin(y)/cos(x)) ;
    cos(x)*sin(2*y)/(2*sin(y)**2) ; 0.9999999999*cos(x)/(sin(y)/cos(y))
shearflow2: (cos(y)**2 + 0.1*sin(y)**2)*sin(x) ; (0.1 + 0.9*cos(y)**2)*sin(x) ; (1 - 0.9*sin(y)**2)*sin(x) ;
    (0.55 + 0.45*cos(2*y))*sin(x) ; 0.9999999999*sin(x) - 0.9*sin(x)*sin(y)*sin(y) ;
    -(cos(y)*cos(y) + 0.1*sin(y)**2)*sin(-x)
vdp1: 10*(y - (x**3 - x)/3) ; 10*y + 3.3333333333333335*x - 3.3333333333333335*x**3 ; 10*(y + x/3 - x*x*x/3) ;
    (y + (x - x**3)/3)/0.1 ; 3.3333333333*(3.0*y + x - x**3) ; x*(10/3 - x*x/0.3) + 10*y
vdp2: -x/10 ; -0.1*x ; x*(-0.1) ; x/(-10.0) ; 0.05*x - 0.15*x ; -(0.0999999999*x)
lv1: 3*x - 2*x*y - x**2 ; x*(3 - 2*y - x) ; 3*x - x*(2*y + x) ; -x*(x + 2*(y - 1.5)) ;
    2.0*x*(1.4999999999 - y - 0.5*x) ; x*x*(3/x - 2*y/x - 1)
lv2: 2*y - x*y - y**2 ; y*(2 - x - y) ; -y*(x + y - 2) ; 2*y - y*(x + y) ; y*(2.0000000001 - 0.9999999999*x) - y*y ;
    y*y*(2/y - x/y - 1)
""")
"""By file: the truth, and forms of it."""

OTHERS: Final = _forms("""
glider1: -0.05*x**2 - cos(y) ; -0.052*x**2 - sin(y)
glider2: x - sin(y)/x ; x - 1.02*cos(y)/x
bacres1: 20 - x - x*y/(1.2 + 0.5*x**2) ; 20 - x - 2*y/x
bacres2: 10 - x*y/(1 + 0.52*x**2) ; 10 - 2*y/x
predprey1: x*(4 - x - y/(1.05 + x)) ; x*(4 - x - y/x)
predprey2: y*(tanh(x) - 0.075*y) ; y*(x/(1.02 + x) - 0.075*y)
barmag1: 0.5*sin(x - y) - 1.02*sin(x) ; 0.5*sin(x - y) - sin(x) + 0.001*x
barmag2: 0.49*sin(y - x) - sin(y) ; 0.5*sin(y - 1.05*x) - sin(y)
shearflow1: cos(x)/y ; cos(x)/sin(y)
shearflow2: cos(y)**2*sin(x) ; (cos(y)**2 + 0.12*sin(y)**2)*sin(x)
vdp1: 10*(y - (x**3 - 1.01*x)/3) ; 10*y - 3.34*x**3 + 3.333*x
vdp2: -0.1*x + 0.001*y ; -x*x/10
lv1: 3*x - 2.01*x*y - x**2 ; 3*x - 2*x*y - x**2 + 0.01*y
lv2: 2*y - x*y - 1.01*y**2 ; 2*y - x*y - y**2 - 0.01*x
""")

UNCREDITED: Final = {
    "barmag1": "0.4999999999*sin(x - 1.0000000001*y) - sin(x)",
    "predprey2": "0.075*y*(13.333333333333*x/(1 + x) - y)",
    "vdp1": "x*(3.3333333333 - 3.3333333333*x*x) + 10*y",
}
"""Equivalent forms that SRBench's rule does not credit.

A factor 1.0 within a sine is not dropped, and a number with three digits left is not multiplied to the true one.
"""

OVERCREDITED: Final = {
    "barmag2": "0.5*sin(y - x) - sin(y) + 0.1",
    "vdp2": "-0.12*x",
    "predprey2": "y*(x/(1 + x) - 0.0754*y)",
}
"""Forms that SRBench's rule credits although they differ: by a summand, by a factor, by less than it rounds to."""

ROWS: Final = 200
_RANGES: Final = {
    "glider": ((1.0, 9.0), (-2.0, 30.0)),
    "bacres": ((0.5, 12.0), (3.0, 18.0)),
    "barmag": ((-3.0, 6.0), (-3.0, 6.0)),
    "shearflow": ((-3.1, 3.1), (0.2, 1.5)),
    "vdp": ((-2.2, 2.2), (-1.0, 1.0)),
}
"""Roughly those of the data sets, by the beginning of the name."""

_POSITIVE: Final = ((0.3, 8.0), (0.3, 8.0))


def rows_of(name: str) -> tuple[dict[str, FloatArray], FloatArray]:
    """Return rows to judge by (x and y, R values each) and the true labels on them."""
    generator = np.random.default_rng(0)
    ranges = _RANGES.get(name.rstrip("12"), _POSITIVE)
    columns = {name: generator.uniform(*bounds, ROWS) for name, bounds in zip("xy", ranges, strict=True)}
    return columns, values_of(from_infix(EQUIVALENTS[name][0], tuple(columns)), np.array([*columns.values()]))
