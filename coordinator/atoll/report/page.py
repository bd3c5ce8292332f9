"""The page: a head, a list of its sections, and the sections."""

from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Final

from atoll.report.equations import choice, constants, origin, overview, search
from atoll.report.findings import Findings
from atoll.report.markup import HEIGHT, WIDTH, Chart, Element, element, paragraph, to_text
from atoll.report.trajectories import dynamics, fitted_values, process, trajectories
from atoll_coordinator.model.batches import Spread
from atoll_coordinator.result.result import Result
from atoll_core import VERSION

_POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""The browser loads no resource and runs no script, even if names in the data contain markup."""


def as_html(result: Result, spread: Spread | None = None) -> str:
    """Return the page of a result; the analyses of its model take seconds, and `spread` distributes them."""
    return as_text(build_page(result, spread))


def as_text(page: Element) -> str:
    """Return a page as HTML."""
    return "<!DOCTYPE html>\n" + to_text(page) + "\n"


def build_page(result: Result, spread: Spread | None = None) -> Element:
    """Return the page of a result as an element; `spread` distributes the analyses over workers."""
    findings = Findings.of(result, spread)
    sections = [
        overview(findings),
        *fitted_values(findings),
        *trajectories(findings),
        *constants(findings),
        *choice(findings),
        *dynamics(findings),
        *process(findings),
        *search(findings),
        origin(findings),
    ]
    names = (result.data and result.data.files) or (f"job {result.job}",)
    title = f"Equations of {', '.join(names)}"
    links = (element("li", element("a", part[0].text or "", href=f"#{part.get('id')}")) for part in sections)
    contents = element("nav", element("ul", *links), aria_label="Contents")
    foot = element("footer", paragraph(f"Written by Atoll {VERSION}."))
    body = element("body", element("header", element("h1", title), contents), element("main", *sections), foot)
    return element("html", _head(title), body, lang="en")


def pictures(page: Element) -> dict[str, str]:
    """Return the pictures of a page as separate SVG files, by name: the section and a number, ``fit-1.svg``."""
    pictures_by_name: dict[str, str] = {}
    for part in page.iter("section"):
        name, drawn = part.get("id"), [picture for picture in part.iter("svg") if picture.get("role") == "img"]
        for number, picture in enumerate(drawn, start=1):
            pictures_by_name[f"{name}-{number}.svg"] = _alone([*picture], picture.attrib)
    return pictures_by_name


def stacked_picture(charts: Sequence[Chart]) -> str:
    """Return charts, one below another, as one SVG file."""
    drawn = [chart.svg() for chart in charts]
    parts = [
        element("svg", *part, x=0, y=place * HEIGHT, width=WIDTH, height=HEIGHT) for place, part in enumerate(drawn)
    ]
    title = "; ".join(chart.title for chart in charts)
    return _alone(parts, {"role": "img", "aria-label": title, "viewBox": f"0 0 {WIDTH} {HEIGHT * len(parts)}"})


def _alone(parts: Sequence[Element], attributes: Mapping[str, str]) -> str:
    """Return the parts of a picture as an SVG file with its style."""
    ground = element("rect", width="100%", height="100%", fill="#ffffff")
    style = element("style", _style("pictures"))
    return to_text(element("svg", style, ground, *parts, **attributes, xmlns="http://www.w3.org/2000/svg")) + "\n"


def _head(title: str) -> Element:
    return element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("link", rel="icon", href="data:,"),
        element("title", title),
        element("style", _style("pictures") + _style("page")),
    )


@cache
def _style(name: str) -> str:
    return files("atoll.report").joinpath(f"{name}.css").read_text("utf-8")
