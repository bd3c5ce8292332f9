"""Pictures of curves, points and bands as SVG. Pure."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Final

from atoll.display.curves import SHOWN
from atoll.report.markup import Element, element

WIDTH: Final = 440
HEIGHT: Final = 280
COLORS: Final = SHOWN
"""Classes ``c0``, ``c1``, … of the style sheet: one for each trajectory that is drawn."""

_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 12, 12, 44
_TICKS: Final = 5
_PLAIN: Final = (1e-4, 1e6)
"""Labels of ticks with smaller steps, or of larger numbers, have exponents."""
_FEW_DECADES: Final = 2.0
_BEYOND: Final = 0.04
"""Share of a range that an axis reaches beyond it."""

Number = float | None
Numbers = Sequence[Number]


@dataclass(frozen=True)
class Axis:
    """One axis: its label, whether it is logarithmic, and bounds (None: as wide as what is drawn)."""

    label: str
    is_logarithmic: bool = False
    bounds: tuple[float, float] | None = None


@dataclass(frozen=True)
class _Layer:
    kind: str
    style: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass
class Chart:
    """A picture with two axes; what is added later is drawn above. `title` says to who cannot see it what it shows."""

    title: str
    x: Axis
    y: Axis
    _layers: list[_Layer] = field(default_factory=list)

    def add_line(self, x: Numbers, y: Numbers, style: str) -> None:
        """Add a line, interrupted where a number is missing; `style` is a class of the style sheet."""
        self._add("line", style, x, y)

    def add_points(self, x: Numbers, y: Numbers, style: str) -> None:
        """Add points."""
        self._add("points", style, x, y)

    def add_band(self, x: Numbers, lower: Numbers, upper: Numbers, style: str) -> None:
        """Add the area between two curves over the same `x`, where both are known."""
        rows = [row for row in zip(x, lower, upper, strict=True) if None not in row]
        forth, back = [(row[0], row[1]) for row in rows], [(row[0], row[2]) for row in reversed(rows)]
        self._add("area", style, *zip(*forth, *back, strict=True)) if rows else None

    def add_cells(self, x: Numbers, y: Numbers, style: str) -> None:
        """Add rectangles, each from a corner to the opposite one: two numbers of `x` and `y` for each, all known."""
        self._add("cells", style, x, y)

    def _add(self, kind: str, style: str, x: Numbers, y: Numbers) -> None:
        places = (tuple(_on(axis, value) for value in values) for axis, values in ((self.x, x), (self.y, y)))
        self._layers.append(_Layer(kind, style, *places))

    def svg(self) -> Element:
        """Return the picture."""
        scales = (
            _Scale(self._bounds(self.x, [layer.x for layer in self._layers]), _LEFT, WIDTH - _RIGHT),
            _Scale(self._bounds(self.y, [layer.y for layer in self._layers]), HEIGHT - _BOTTOM, _TOP),
        )
        width, height = WIDTH - _LEFT - _RIGHT, HEIGHT - _TOP - _BOTTOM
        drawn = (_layer_element(layer, *scales) for layer in self._layers)
        box = f"{_LEFT} {_TOP} {width} {height}"
        inside = element("svg", *drawn, x=_LEFT, y=_TOP, width=width, height=height, viewBox=box)
        whole = {"role": "img", "aria_label": self.title, "viewBox": f"0 0 {WIDTH} {HEIGHT}"}
        return element("svg", *self._axes(*scales), inside, **whole)

    def _bounds(self, axis: Axis, values: Iterable[Sequence[float]]) -> tuple[float, float]:
        if axis.bounds is not None:
            low, high = (_on(axis, bound) for bound in axis.bounds)
            return low, high
        known = [value for value in chain.from_iterable(values) if math.isfinite(value)] or [0.0, 1.0]
        low, high = min(known), max(known)
        beyond = _BEYOND * (high - low) or abs(high) or 1.0
        return low - beyond, high + beyond

    def _axes(self, across: "_Scale", up: "_Scale") -> list[Element]:
        bottom, middle = HEIGHT - _BOTTOM, 0.5 * (_TOP + HEIGHT - _BOTTOM)
        made = [element("path", class_="axis", d=f"M{_LEFT},{_TOP}V{bottom}H{WIDTH - _RIGHT}", fill="none")]
        for place, label in ticks(across.bounds, self.x.is_logarithmic):
            at = round(across(place), 1)
            made.append(element("path", class_="grid", d=f"M{at},{_TOP}V{bottom}"))
            made.append(element("text", label, x=at, y=bottom + 16, text_anchor="middle"))
        for place, label in ticks(up.bounds, self.y.is_logarithmic):
            at = round(up(place), 1)
            made.append(element("path", class_="grid", d=f"M{_LEFT},{at}H{WIDTH - _RIGHT}"))
            made.append(element("text", label, x=_LEFT - 6, y=at + 4, text_anchor="end"))
        rotation = f"rotate(-90 14 {middle})"
        made.append(element("text", self.y.label, x=14, y=middle, text_anchor="middle", transform=rotation))
        centre = 0.5 * (_LEFT + WIDTH - _RIGHT)
        made.append(element("text", self.x.label, x=centre, y=HEIGHT - 8, text_anchor="middle"))
        return made


@dataclass(frozen=True)
class _Scale:
    """From numbers within bounds to pixels."""

    bounds: tuple[float, float]
    first: float
    last: float

    def __call__(self, value: float) -> float:
        low, high = self.bounds
        return self.first + (self.last - self.first) * (value - low) / (high - low)


def _on(axis: Axis, value: Number) -> float:
    """Return a number on an axis; NaN of what has no place there."""
    if value is None or not math.isfinite(value):
        return math.nan
    if not axis.is_logarithmic:
        return float(value)
    return math.log10(value) if value > 0.0 else math.nan


def _layer_element(layer: _Layer, across: _Scale, up: _Scale) -> Element:
    places = [
        (round(across(x), 1), round(up(y), 1)) if math.isfinite(x) and math.isfinite(y) else None
        for x, y in zip(layer.x, layer.y, strict=True)
    ]
    known = [place for place in places if place]
    if layer.kind == "points":
        dots = (element("circle", cx=x, cy=y, r=3) for x, y in known)
        return element("g", *dots, class_=f"points {layer.style}")
    if layer.kind == "cells":
        corners = zip(known[::2], known[1::2], strict=True)
        path = "".join(f"M{left},{bottom}H{right}V{top}H{left}Z" for (left, bottom), (right, top) in corners)
        return element("path", class_=f"area {layer.style}", d=path)
    ending = "Z" if layer.kind == "area" else ""
    return element("path", class_=f"{layer.kind} {layer.style}", d=_path(places) + ending)


def _path(places: Iterable[tuple[float, float] | None]) -> str:
    parts, is_down = [], False
    for place in places:
        if place is not None:
            parts.append(f"{'L' if is_down else 'M'}{place[0]},{place[1]}")
        is_down = place is not None
    return "".join(parts)


def ticks(bounds: tuple[float, float], is_logarithmic: bool) -> list[tuple[float, str]]:
    """Return places and labels of ticks within `bounds`; where these are logarithms, of powers of ten and parts."""
    return _logarithmic_ticks(*bounds) if is_logarithmic else _even_ticks(*bounds)


def _even_ticks(low: float, high: float) -> list[tuple[float, str]]:
    step = _step((high - low) / _TICKS)
    places = [index * step for index in range(math.ceil(low / step), math.floor(high / step) + 1)]
    largest = max(abs(low), abs(high))
    if _PLAIN[0] <= step and largest < _PLAIN[1]:
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        return [(place, f"{place:.{decimals}f}") for place in places]
    digits = math.ceil(math.log10(largest / step)) + 1
    return [(place, f"{place:.{digits}g}") for place in places]


def _logarithmic_ticks(low: float, high: float) -> list[tuple[float, str]]:
    decades = range(math.floor(low), math.ceil(high) + 1)
    every = max(1, math.ceil((high - low) / _TICKS))
    parts = (1.0, 2.0, 5.0) if high - low < _FEW_DECADES else (1.0,)
    places = [(decade + math.log10(part), decade, part) for decade in decades if decade % every == 0 for part in parts]
    made = [(place, f"{part * 10.0**decade:g}") for place, decade, part in places if low <= place <= high]
    if len(made) > 1:
        return made
    return [(math.log10(value), label) for value, label in _even_ticks(10.0**low, 10.0**high) if value > 0.0]


def _step(least: float) -> float:
    """Return the least of 1, 2 and 5 times a power of ten that is not below `least`."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= 0.999999 * least)
