"""What a page holds for its scripts: figures as JSON that no text can leave, and which scripts may run."""

from __future__ import annotations

import base64
import hashlib
import html
import re
import unicodedata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

    import plotly.graph_objects as go

# Room that a title inside of a figure takes, px; the page writes titles itself, where they wrap.
_TITLE_PX = 44
# Of a name that is to become the name of a file.
_LONGEST = 80
_ESCAPED = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}


def embedded(value: object) -> str:
    """A value as JSON for a script element: the characters that end an element or begin a comment are escaped."""
    from plotly.io.json import to_json_plotly

    return to_json_plotly(value, engine="json").translate(_ESCAPED)


def figure_data(figure: go.Figure, template: object) -> tuple[dict[str, Any], list[str]]:
    """A figure's traces, layout and steps, and the labels of the steps.

    The layout goes without ``template``, which the page holds once, without titles, which do not wrap in a figure, and
    without plotly's own slider, which no keyboard reaches: its steps are chosen by a control of the page. A 3-D view
    comes as its scene, of which the page's script draws what a reader chooses.
    """
    whole = figure.to_plotly_json()
    layout = dict(whole["layout"])
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
        return {"data": _without_points(whole["data"]), "layout": layout, "steps": labels, "scene": scene}, labels
    return {"data": whole["data"], "layout": layout, **({"steps": steps} if steps else {})}, labels


def _without_points(traces: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{name: value for name, value in trace.items() if name not in ("x", "y", "z", "text")} for trace in traces]


def text_of(marked: str | None) -> str:
    """The words of a text that plotly reads as markup."""
    return html.unescape(re.sub(r"<[^<>]*>", " ", marked or "")).strip()


def file_name(campaign: str, part: str) -> str:
    """The name under which a part of the page is saved, without what file systems or shells mind."""
    name = re.sub(r"[^\w.-]+", "-", unicodedata.normalize("NFC", campaign)).strip("-.")[:_LONGEST]
    return f"{name or 'campaign'}-{part}.csv"


def policy(scripts: Iterable[str]) -> str:
    """The page's content security policy: these scripts and no others run, and nothing is loaded or sent.

    What plotly draws by WebGL it compiles itself, which is an ``eval`` to a browser.
    """
    hashes = (f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'" for script in scripts)
    return (
        f"default-src 'none'; script-src {' '.join(hashes)} 'unsafe-eval'; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
