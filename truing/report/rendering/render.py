"""The page as one self-contained HTML file, with the same bytes for the same tables."""

from __future__ import annotations

import base64
import hashlib
import html
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import plotly.graph_objects as go

from truing.report.numbers import count_text
from truing.report.page import FIRST_SCREEN, Listing, PageHead, ReportSection, all_of
from truing.report.rendering.terms import COLUMN, Meanings, anchors, defined, explained, marked

if TYPE_CHECKING:
    from collections.abc import Iterable

    import jinja2


# Height of a title inside a figure, px; the page writes titles itself, so that they wrap.
_TITLE_PX = 44
_LONGEST = 80  # characters of a campaign's name in the name of a file
# Characters that would end a script element or begin a comment.
_ESCAPED = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}


@dataclass(frozen=True)
class _Figure:
    """A figure in the form of the page."""

    name: str
    caption: str
    title: str
    subtitle: str
    description: str  # alternative text for readers who cannot see it
    height_px: int
    data: str  # JSON, safe in a script element
    step_of: str  # quantity chosen by its slider: "pose"
    steps: tuple[str, ...]
    gains: tuple[str, ...]  # amplifications of a 3-D view to choose from
    gain: int  # index of the initial one
    legs: tuple[int, ...]
    file: str


@dataclass(frozen=True)
class _ListingTable:
    """A listing with its name, its CSV if that differs from the cells, and the ids of rows that explain something."""

    listing: Listing
    called: str
    csv: str  # JSON, safe in a script element
    file: str
    ids: tuple[str, ...]


@dataclass(frozen=True)
class _RenderedSection:
    """A section in the form of the page, with its figures, listings and subsections."""

    section: ReportSection
    figures: tuple[_Figure, ...]
    tables: tuple[_ListingTable, ...]
    parts: tuple[_RenderedSection, ...]
    used: set[str] = field(default_factory=set)  # glossary terms that already have a tooltip

    @property
    def more(self) -> str:
        """Title of the folded part of an essential section; empty where it has no more."""
        counts = ((len(self.figures) - self.section.front, "figure"), (len(self.tables), "table"))
        return " and ".join(count_text(number, noun) for number, noun in counts if number > 0)


def render_page(head: PageHead, sections: Sequence[ReportSection]) -> str:
    """Return the whole page as text; it contains plotly's library once, so that it opens without a network."""
    any_figure = any(section.figures for section in all_of(sections))
    plotly = _plotly_script() if any_figure else ""
    scripts = [_package_text(f"{name}.js") for name in ("scene", "narrow", "figures", "csv", "tables", "tips")]
    return _template().render(
        head=head,
        first_screen=FIRST_SCREEN,
        head_terms=set[str](),  # glossary terms that already have a tooltip there
        meanings=_meanings(sections),
        ids={section.id for section in all_of(sections)},
        sections=[_rendered(section, head.campaign) for section in sections],
        next=next((section.title for section in all_of(sections) if section.id == "next"), ""),
        style=_package_text("page.css"),
        print_marks=_print_marks(head),
        scripts=scripts,
        plotly=plotly,
        figure_template=embedded(_figure_template()) if any_figure else "",
        policy=_policy([*scripts, plotly]),
    )


def _meanings(sections: Sequence[ReportSection]) -> Meanings:
    """Return the rows of the page's tables that explain a check, a cause, a column or a term."""
    by_name: dict[tuple[str, str], tuple[str, str]] = {}
    columns: dict[str, str] = {}
    for listing in (listing for section in all_of(sections) for listing in section.listings if listing.anchor):
        for anchor, (name, meaning, *_) in zip(anchors(listing.rows, listing.anchor), listing.rows, strict=True):
            if listing.anchor == COLUMN:
                columns[meaning] = anchor
            else:
                by_name[listing.anchor, name] = (anchor, meaning)
    return Meanings(by_name, columns)


def _print_marks(head: PageHead) -> str:
    """Return the style of the paper's edge: title and day on the left, page numbers on the right."""
    words = " · ".join(filter(None, (head.about.title or head.campaign, head.about.made)))
    escaped = "".join(c if c.isascii() and c.isalnum() else f"\\{ord(c):x} " for c in words)
    size = "font: 8pt system-ui, sans-serif; color: #5c6875;"
    left = f'@bottom-left {{ content: "{escaped}"; {size} }}'
    return f'@page {{ {left} @bottom-right {{ content: counter(page) " / " counter(pages); {size} }} }}\n'


def _rendered(section: ReportSection, campaign: str) -> _RenderedSection:
    figures = (_figure(*shown, f"{section.id}-{k}", campaign) for k, shown in enumerate(section.figures))
    parts = (_rendered(part, campaign) for part in section.parts)
    return _RenderedSection(section, tuple(figures), tuple(_tables(section, campaign)), tuple(parts))


def _figure(figure: go.Figure, caption: str, name: str, campaign: str) -> _Figure:
    data, steps = _figure_data(figure, _figure_template())
    title, subtitle = (text_of(text) for text in (figure.layout.title.text, figure.layout.title.subtitle.text))
    step_of = text_of(figure.layout.sliders[0].currentvalue.prefix) if steps else ""
    height = int(data["layout"]["height"])
    spoken = ". ".join(words.rstrip(".") for words in (title, subtitle, caption) if words)
    file = file_name(campaign, name)
    scene = data.get("scene", {"gains": [], "gain": None, "legs": []})
    gains = tuple(f"{gain:g} times" for gain in scene["gains"])
    first = scene["gains"].index(scene["gain"]) if gains else 0
    embedded_data = embedded(data)
    return _Figure(
        *(name, caption, title, subtitle, f"{spoken}.", height, embedded_data, step_of, tuple(steps), gains, first),
        legs=tuple(scene["legs"]),
        file=file,
    )


def _tables(section: ReportSection, campaign: str) -> Iterator[_ListingTable]:
    for k, listing in enumerate(section.listings):
        csv = embedded(listing.csv) if listing.csv else ""
        file = file_name(campaign, f"{section.id}-table-{k}")
        ids = anchors(listing.shown, listing.anchor) if listing.anchor else ()
        yield _ListingTable(listing, listing.caption or section.title, csv, file, ids)


@cache
def _figure_template() -> dict[str, Any]:
    """Return the style of all figures in plotly's form."""
    template: dict[str, Any] = go.Figure(layout={"template": "plotly_white"}).to_plotly_json()["layout"]["template"]
    return template


def _plotly_script() -> str:
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


@cache
def _package_text(name: str) -> str:
    """Return a file of this package as text."""
    return files("truing.report.rendering").joinpath(name).read_text(encoding="utf-8")


@cache
def _template() -> jinja2.Template:
    import jinja2

    loader = jinja2.PackageLoader("truing.report.rendering", "")
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"unbroken": _with_fixed_spaces, "terms": marked, "defined": defined, "explained": explained}
    return environment.get_template("report.html.jinja")


def _with_fixed_spaces(sentence: str) -> str:
    """Return a sentence with non-breaking spaces between numbers and units."""
    return re.sub(
        r"(?<=\d) (?=%|[µm]m\b|µrad|mrad|arcsec|ppm|(?:deg|px|mV|K|kg|N)\b|N·m|± )|(?<=±) (?=\d)", "\u00a0", sentence
    )


def embedded(value: object) -> str:
    """Return a value as JSON for a script element, with the characters escaped that end an element or
    begin a comment."""
    from plotly.io.json import to_json_plotly

    return to_json_plotly(value, engine="json").translate(_ESCAPED)


def _figure_data(figure: go.Figure, template: object) -> tuple[dict[str, Any], list[str]]:
    """Return a figure's traces, layout and steps, and the labels of the steps.

    Three parts of the layout are left out: ``template``, which the page holds once; titles, which do not wrap in a
    figure; and plotly's slider, which no keyboard reaches. A control of the page chooses the steps. A 3-D view is given
    as its scene, of which the page's script draws the reader's choice.
    """
    figure_json = figure.to_plotly_json()
    layout = dict(figure_json["layout"])
    if layout.get("template") == template:
        del layout["template"]
    if layout.pop("title", None):
        layout["margin"] = {**layout["margin"], "t": layout["margin"]["t"] - _TITLE_PX}
        layout["height"] -= _TITLE_PX
    sliders = layout.pop("sliders", ())
    steps = [{"label": text_of(step["label"]), "args": step["args"]} for slider in sliders for step in slider["steps"]]
    labels = [step["label"] for step in steps]
    scene = layout.pop("meta", {}).get("scene")
    if scene:  # its script computes what the steps hold
        return {"data": _without_points(figure_json["data"]), "layout": layout, "steps": labels, "scene": scene}, labels
    return {"data": figure_json["data"], "layout": layout, **({"steps": steps} if steps else {})}, labels


def _without_points(traces: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{name: value for name, value in trace.items() if name not in ("x", "y", "z", "text")} for trace in traces]


def text_of(marked: str | None) -> str:
    """Return the text of plotly markup."""
    return html.unescape(re.sub(r"<[^<>]*>", " ", marked or "")).strip()


def file_name(campaign: str, part: str) -> str:
    """Return the file name of a part of the page, without characters that file systems or shells reject."""
    name = re.sub(r"[^\w.-]+", "-", unicodedata.normalize("NFC", campaign)).strip("-.")[:_LONGEST]
    return f"{name or 'campaign'}-{part}.csv"


def _policy(scripts: Iterable[str]) -> str:
    """Return the page's content security policy: only these scripts run, and nothing is loaded or sent. Plotly compiles
    its WebGL code itself, which a browser treats as ``eval``."""
    hashes = (f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'" for script in scripts)
    return (
        f"default-src 'none'; script-src {' '.join(hashes)} 'unsafe-eval'; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
