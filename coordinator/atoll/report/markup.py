"""Elements of HTML, SVG and MathML. Texts and attributes are escaped when a page is written, whatever they hold."""

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import Final
from xml.etree import ElementTree

from atoll.model.parameters import r2_text

Element = ElementTree.Element
Child = Element | str

_MATHML: Final = "{http://www.w3.org/1998/Math/MathML}"


def element(tag: str, *children: Child, **attributes: str | float) -> Element:
    """Return an element; ``class_`` stands for the attribute ``class``, and ``stroke_width`` for ``stroke-width``."""
    made = Element(tag, {name.rstrip("_").replace("_", "-"): str(value) for name, value in attributes.items()})
    for child in children:
        if not isinstance(child, str):
            made.append(child)
        elif len(made):
            made[-1].tail = (made[-1].tail or "") + child
        else:
            made.text = (made.text or "") + child
    return made


def section(identifier: str, title: str, *children: Child) -> Element:
    """Return a section with its heading, which others may link to."""
    return element("section", element("h2", title), *children, id=identifier)


def paragraph(*children: Child) -> Element:
    """Return a paragraph."""
    return element("p", *children)


def facts(pairs: Iterable[tuple[str, Child]]) -> Element:
    """Return a list of terms and what is said of each."""
    listed = [(element("dt", term), element("dd", description)) for term, description in pairs]
    return element("dl", *chain.from_iterable(listed))


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[Child]], *, is_stacked: bool = False) -> Element:
    """Return a table that scrolls by itself where it is wider than the page; texts that are numbers stand right.

    A column without any entry is left out. One that `is_stacked` has its cells below each other on narrow pages.
    """
    rows = [*rows]
    kept = [place for place in range(len(heads)) if not rows or any(row[place] != "" for row in rows)]
    head = element("tr", *(element("th", heads[place], scope="col") for place in kept))
    body = element("tbody", *(element("tr", *(_cell(row[place], heads[place]) for place in kept)) for row in rows))
    kind = {"class_": "stacked"} if is_stacked else {}
    made = element("table", element("caption", caption), element("thead", head), body, **kind)
    return scrolling(caption, made)


def _cell(content: Child, head: str) -> Element:
    is_number = isinstance(content, str) and content[:1] in "-0123456789" and content != ""
    return element("td", content, data_head=head, **({"class_": "number"} if is_number else {}))


def scrolling(label: str, content: Element) -> Element:
    """Return content in a box that scrolls sideways, also by keyboard."""
    return element("div", content, class_="wide", role="region", tabindex="0", aria_label=label)


def figure(picture: Element, caption: str, numbers: Element | None, *legend: Element) -> Element:
    """Return a picture with its caption, its legend, and its numbers behind it."""
    behind = () if numbers is None else (element("details", element("summary", "Numbers"), numbers),)
    return element("figure", picture, *legend, element("figcaption", caption), *behind)


def pictures(figures: Iterable[Element]) -> Element:
    """Return figures beside each other."""
    return element("div", *figures, class_="pictures")


def legend(names: Iterable[tuple[str, str]]) -> Element:
    """Return a legend: the class of a mark, and what it stands for."""
    marks = (element("li", element("span", class_=f"swatch {kind}"), name) for kind, name in names)
    return element("ul", *marks, class_="legend")


def parse_mathml(text: str) -> Element:
    """Return MathML as elements without the prefix of a namespace, as HTML has them."""
    root = ElementTree.fromstring(text)
    for part in root.iter():
        part.tag = part.tag.removeprefix(_MATHML)
    return root


def number(value: float | None, digits: int = 4) -> str:
    """Return a number as text with so many significant digits; "" of None."""
    return "" if value is None else f"{value:.{digits}g}"


def r2_cell(value: float | None) -> str:
    """Return R2 for a table, never rounded up to 1; "" of None."""
    return "" if value is None else r2_text(value)


def to_text(root: Element) -> str:
    """Return an element as HTML."""
    return ElementTree.tostring(root, encoding="unicode", method="html")
