"""Elements of HTML, SVG and MathML, and charts of curves, points and bands as SVG. All functions are pure.

All texts and attributes are escaped when a page is written.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Final
from xml.etree import ElementTree

from atoll.display.curves import SHOWN
from atoll.model.equations import r2_text

Element = ElementTree.Element
Child = Element | str

_MATHML: Final = "{http://www.w3.org/1998/Math/MathML}"


def element(tag: str, *children: Child, **attributes: str | float) -> Element:
    """Return an element; ``class_`` means the attribute ``class``, and ``stroke_width`` means ``stroke-width``."""
    built = Element(tag, {name.rstrip("_").replace("_", "-"): str(value) for name, value in attributes.items()})
    for child in children:
        if not isinstance(child, str):
            built.append(child)
        elif len(built):
            built[-1].tail = (built[-1].tail or "") + child
        else:
            built.text = (built.text or "") + child
    return built


def section(identifier: str, title: str, *children: Child) -> Element:
    """Return a section with its heading; links can refer to the identifier."""
    return element("section", element("h2", title), *children, id=identifier)


def paragraph(*children: Child) -> Element:
    """Return a paragraph."""
    return element("p", *children)


def facts(pairs: Iterable[tuple[str, Child]]) -> Element:
    """Return a list of terms with their descriptions."""
    listed = [(element("dt", term), element("dd", description)) for term, description in pairs]
    return element("dl", *chain.from_iterable(listed))


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[Child]], *, is_stacked: bool = False) -> Element:
    """Return a table that scrolls if it is wider than the page, with numbers aligned to the right.

    Empty columns are left out. If `is_stacked`, narrow pages show the cells of a row one below another.
    """
    rows = [*rows]
    kept = [place for place in range(len(heads)) if not rows or any(row[place] != "" for row in rows)]
    head = element("tr", *(element("th", heads[place], scope="col") for place in kept))
    body = element("tbody", *(element("tr", *(_cell(row[place], heads[place]) for place in kept)) for row in rows))
    kind = {"class_": "stacked"} if is_stacked else {}
    built = element("table", element("caption", caption), element("thead", head), body, **kind)
    return scrolling(caption, built)


def _cell(content: Child, head: str) -> Element:
    is_number = isinstance(content, str) and content[:1] in "-0123456789" and content != ""
    return element("td", content, data_head=head, **({"class_": "number"} if is_number else {}))


def scrolling(label: str, content: Element) -> Element:
    """Return content in a box that scrolls sideways, also with the keyboard."""
    return element("div", content, class_="wide", role="region", tabindex="0", aria_label=label)


def figure(picture: Element, caption: str, numbers: Element | None, *legend: Element) -> Element:
    """Return a picture with its legend and caption; its numbers are in a box that the reader can open."""
    behind = () if numbers is None else (element("details", element("summary", "Numbers"), numbers),)
    return element("figure", picture, *legend, element("figcaption", caption), *behind)


def pictures(figures: Iterable[Element]) -> Element:
    """Return figures next to each other."""
    return element("div", *figures, class_="pictures")


def legend(names: Iterable[tuple[str, str]]) -> Element:
    """Return a legend: the class and the meaning of each mark."""
    marks = (element("li", element("span", class_=f"swatch {kind}"), name) for kind, name in names)
    return element("ul", *marks, class_="legend")


def parse_mathml(text: str) -> Element:
    """Return MathML as elements without namespace, as in HTML."""
    root = ElementTree.fromstring(text)
    for part in root.iter():
        part.tag = part.tag.removeprefix(_MATHML)
    return root


def number(value: float | None, digits: int = 4) -> str:
    """Return a number as text with `digits` significant digits; "" for None."""
    return "" if value is None else f"{value:.{digits}g}"


def r2_cell(value: float | None) -> str:
    """Return R2 for a table, never rounded up to 1; "" for None."""
    return "" if value is None else r2_text(value)


def to_text(root: Element) -> str:
    """Return an element as HTML."""
    return ElementTree.tostring(root, encoding="unicode", method="html")


WIDTH: Final = 440
HEIGHT: Final = 280
COLORS: Final = SHOWN
"""Classes ``c0``, ``c1``, … of the style sheet, one for each drawn trajectory."""

_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 12, 12, 44
_TICKS: Final = 5
_PLAIN: Final = (1e-4, 1e6)
"""Labels of ticks have exponents if steps are below the first number, or if values are above the second number."""
_FEW_DECADES: Final = 2.0
_MARGIN: Final = 0.04
"""Margin of an axis as a share of its range."""

Number = float | None
Numbers = Sequence[Number]


@dataclass(frozen=True)
class Axis:
    """One axis: its label, whether it is logarithmic, and bounds (None: the range of the data)."""

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
    """A picture with two axes; later layers cover earlier layers. `title` is its text for screen readers."""

    title: str
    x: Axis
    y: Axis
    _layers: list[_Layer] = field(default_factory=list)

    def add_line(self, x: Numbers, y: Numbers, style: str) -> None:
        """Add a line, interrupted where a number is missing; `style` is a class of the style sheet."""
        self._add("line", style, x, y)

    def add_points(self, x: Numbers, y: Numbers, style: str) -> None:
        """Add points; missing numbers are left out."""
        self._add("points", style, x, y)

    def add_band(self, x: Numbers, lower: Numbers, upper: Numbers, style: str) -> None:
        """Add the area between two curves over the same `x`; rows with a missing number are left out."""
        rows = [row for row in zip(x, lower, upper, strict=True) if None not in row]
        forth, back = [(row[0], row[1]) for row in rows], [(row[0], row[2]) for row in reversed(rows)]
        self._add("area", style, *zip(*forth, *back, strict=True)) if rows else None

    def add_cells(self, x: Numbers, y: Numbers, style: str) -> None:
        """Add rectangles. Two consecutive points of `x` and `y` are opposite corners; no number may be missing."""
        self._add("cells", style, x, y)

    def _add(self, kind: str, style: str, x: Numbers, y: Numbers) -> None:
        places = (tuple(_position(axis, value) for value in values) for axis, values in ((self.x, x), (self.y, y)))
        self._layers.append(_Layer(kind, style, *places))

    @property
    def range_of_values(self) -> tuple[float, float]:
        """The range of the vertical axis, for a line across the picture."""
        return self._bounds(self.y, [layer.y for layer in self._layers])

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
            low, high = (_position(axis, bound) for bound in axis.bounds)
            return low, high
        known = [value for value in chain.from_iterable(values) if math.isfinite(value)] or [0.0, 1.0]
        low, high = min(known), max(known)
        beyond = _MARGIN * (high - low) or abs(high) or 1.0
        return low - beyond, high + beyond

    def _axes(self, across: "_Scale", up: "_Scale") -> list[Element]:
        bottom, middle = HEIGHT - _BOTTOM, 0.5 * (_TOP + HEIGHT - _BOTTOM)
        built = [element("path", class_="axis", d=f"M{_LEFT},{_TOP}V{bottom}H{WIDTH - _RIGHT}", fill="none")]
        for place, label in ticks(across.bounds, self.x.is_logarithmic):
            at = round(across(place), 1)
            built.append(element("path", class_="grid", d=f"M{at},{_TOP}V{bottom}"))
            built.append(element("text", label, x=at, y=bottom + 16, text_anchor="middle"))
        for place, label in ticks(up.bounds, self.y.is_logarithmic):
            at = round(up(place), 1)
            built.append(element("path", class_="grid", d=f"M{_LEFT},{at}H{WIDTH - _RIGHT}"))
            built.append(element("text", label, x=_LEFT - 6, y=at + 4, text_anchor="end"))
        rotation = f"rotate(-90 14 {middle})"
        built.append(element("text", self.y.label, x=14, y=middle, text_anchor="middle", transform=rotation))
        centre = 0.5 * (_LEFT + WIDTH - _RIGHT)
        built.append(element("text", self.x.label, x=centre, y=HEIGHT - 8, text_anchor="middle"))
        return built


@dataclass(frozen=True)
class _Scale:
    bounds: tuple[float, float]
    first: float
    last: float

    def __call__(self, value: float) -> float:
        low, high = self.bounds
        return self.first + (self.last - self.first) * (value - low) / (high - low)


def _position(axis: Axis, value: Number) -> float:
    """Return the position of a number on an axis; NaN if it has no position."""
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
    parts, is_down = [], False
    for place in places:
        if place is not None:
            parts.append(f"{'L' if is_down else 'M'}{place[0]},{place[1]}")
        is_down = place is not None
    ending = "Z" if layer.kind == "area" else ""
    return element("path", class_=f"{layer.kind} {layer.style}", d="".join(parts) + ending)


def ticks(bounds: tuple[float, float], is_logarithmic: bool) -> list[tuple[float, str]]:
    """Return places and labels of ticks within `bounds`; logarithmic ticks are 1, 2 and 5 times powers of ten."""
    return _logarithmic_ticks(*bounds) if is_logarithmic else _even_ticks(*bounds)


def _even_ticks(low: float, high: float) -> list[tuple[float, str]]:
    least = (high - low) / _TICKS
    power = 10.0 ** math.floor(math.log10(least))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= 0.999999 * least)
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
    built = [(place, f"{part * 10.0**decade:g}") for place, decade, part in places if low <= place <= high]
    if len(built) > 1:
        return built
    return [(math.log10(value), label) for value, label in _even_ticks(10.0**low, 10.0**high) if value > 0.0]
