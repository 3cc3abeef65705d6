"""The picture of a report in README.md: verdict, 3-D view, and the matrix that explains it, from the page itself.

truing run sample_data/telescope && python -m docs.experiments.report_picture runs/telescope/report.html

What the picture shows is written next to it, so that a test fails when the page says something else.
"""

from __future__ import annotations

import base64
import hashlib
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.report.browser import Browser, Page
from truing import Run, load
from truing.report import rendering

PICTURE = Path(__file__).parents[1] / "figures" / "report.png"
FACTS = PICTURE.with_suffix(".json")
AGAIN = "truing run sample_data/telescope && python -m docs.experiments.report_picture runs/telescope/report.html"
_STYLE = Path(rendering.__file__).parent / "page.css"
_WIDTH, _HEIGHT = 1240, 860
_SHOWN = ("figure-deformation-0", "figure-deformation-2")
# Leaves the verdict and two figures, side by side; what is operated has no place in a picture.
_ARRANGED = """
(async () => {
  const BELOW = { "margin.l": 0, "margin.t": 8, "margin.b": 80, "legend.y": -0.02, "legend.yanchor": "top" };
  // From farther away than on the page, which is twice as wide, so that axes and machine stay whole.
  const farther = (eye) => Object.fromEntries(Object.entries(eye).map(([axis, at]) => [axis, 1.25 * at]));
  const figures = %s.map((id) => document.getElementById(id).closest("figure"));
  const row = document.createElement("div");
  row.style.cssText = "display:grid;grid-template-columns:1fr 1fr;gap:24px;padding:18px 24px";
  const unwanted = "script.figure-data, p.take, p.steps, fieldset, figcaption";
  document.querySelector("main").style.display = "none";
  document.querySelector("nav").style.display = "none";
  document.querySelectorAll("header dl, .modebar-container").forEach((part) => part.remove());
  document.body.append(row);
  document.querySelector("header > div").style.maxWidth = "none";
  for (const figure of figures) {
    row.append(figure);
    figure.style.minWidth = 0;
    figure.querySelectorAll(unwanted).forEach((part) => (part.style.display = "none"));
    figure.querySelectorAll(".modebar-container").forEach((part) => part.remove());
    const plot = figure.querySelector(".plot");
    plot.style.height = "480px";
    const scene = plot.layout.scene;
    const fit = scene ? { ...BELOW, "scene.camera.eye": farther(scene.camera.eye) } : { "margin.l": 100 };
    await Plotly.relayout(plot, { height: 480, width: plot.clientWidth, ...fit });
    figure.querySelectorAll(".modebar-container").forEach((part) => part.remove());
  }
  scrollTo(0, 0);
  await new Promise((done) => setTimeout(done, 800));
  return row.getBoundingClientRect().bottom;
})()
"""


def shown_facts(run: Run) -> dict[str, Any]:
    """Content of the picture of a run: the verdict, the words of both figures and their traces, and the style sheet."""
    figures = run.figures
    return {
        "verdict": list(run.verdicts[0]),
        "figures": [_figure_facts(figures[name.removeprefix("figure-")].to_plotly_json()) for name in _SHOWN],
        "style": hashlib.sha256(_STYLE.read_bytes()).hexdigest(),
    }


def _figure_facts(figure: dict[str, Any]) -> dict[str, Any]:
    """Title, axes, and kind and name of every trace."""
    layout = figure["layout"]
    axes = {key: axis.get("title", {}).get("text") for key, axis in sorted(layout.items()) if "axis" in key}
    traces = [[trace["type"], trace.get("name")] for trace in figure["data"]]
    return {"title": layout["title"]["text"], "axes": axes, "traces": traces}


def main(page: Path) -> None:
    """Write the picture from a page."""
    with tempfile.TemporaryDirectory() as folder, Browser(Path(folder)) as browser:
        shown = Page(browser, page.resolve().as_uri(), _WIDTH, _HEIGHT)
        shown.scroll_through()
        bottom = shown.value(_ARRANGED % list(_SHOWN))
        clip = {"x": 0, "y": 0, "width": _WIDTH, "height": bottom, "scale": 1}
        reported = shown.ask("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
    PICTURE.write_bytes(base64.b64decode(reported["data"]))
    facts = shown_facts(load(page.parent))
    FACTS.write_text(json.dumps(facts, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
