"""A browser draws every figure of the page, without an error and without the network."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.report.campaign_tables import campaign_tables
from tests.report.test_page import render

BROWSER = next((b for name in ("chromium", "chromium-browser", "google-chrome") if (b := shutil.which(name))), None)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=swiftshader",
    "--enable-unsafe-swiftshader",
    "--enable-logging=stderr",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--virtual-time-budget=8000",
    "--dump-dom",
)
# What chromium says of canvases drawn without a graphics card: of speed, not of errors.
PERFORMANCE_HINTS = ("GPU stall", "Multiple readback operations")
# Moves the slider of the 3-D picture to its last pose, and writes what is then visible where a dump shows it.
MOVE = """<script>window.addEventListener("load", async () => {
  const scene = document.getElementById("figure-deformation-0");
  await new Promise(done => setTimeout(done, 500));
  const steps = scene.layout.sliders[0].steps, last = steps[steps.length - 1];
  await Plotly.update(scene, ...last.args);
  document.body.dataset.visible = JSON.stringify(scene._fullData.map(trace => trace.visible));
  document.body.dataset.expected = JSON.stringify(last.args[0].visible);
  document.body.dataset.frames = steps.length;
});</script></body>"""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """The page's document after drawing, and what the browser logged."""
    html = render(campaign_tables(name="</script><img src=x onerror=document.title='broken'>"))
    return draw(html.replace("</body>", MOVE), tmp_path_factory.mktemp("rendered"))


def draw(html: str, folder: Path) -> tuple[str, str]:
    """The document after a browser has drawn it, and what the browser logged; skips where there is none."""
    if BROWSER is None:
        pytest.skip("no chromium or chrome here to draw the page with")
    page = folder / "report.html"
    page.write_text(html, encoding="utf-8")
    command = [BROWSER, *FLAGS, f"--user-data-dir={folder / 'profile'}", page.as_uri()]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip("the browser does not come to an end on this machine")
    if done.returncode != 0:
        pytest.skip(f"the browser does not run here: {done.stderr[-200:]}")
    return done.stdout, done.stderr


def complaints(log: str) -> list[str]:
    """What the browser logged of the page, its speed left out."""
    said = [line for line in log.splitlines() if "CONSOLE" in line]
    return [line for line in said if not any(word in line for word in PERFORMANCE_HINTS)]


def test_every_figure_is_drawn(drawn):
    dom, _ = drawn
    figures = dict(re.findall(r'<div id="(figure-[a-z]+-\d+)"([^>]*)>', dom))
    assert len(figures) == 8
    parts = re.split(r'<div id="figure-', dom)[1:]
    for part in parts:
        assert 'class="main-svg"' in part, part[:40]
    scene = next(part for part in parts if part.startswith("deformation-0"))
    assert "<canvas" in scene


def test_the_browser_complains_of_nothing(drawn):
    assert not complaints(drawn[1])
    assert "<title>broken" not in drawn[0]


def test_no_button_shares_a_figure(drawn):
    assert 'data-title="Zoom' in drawn[0]  # as the buttons are written
    assert "Share chart" not in re.sub(r"<script.*?</script>", "", drawn[0], flags=re.S)


def test_the_slider_shows_another_pose(drawn):
    body = re.search(r"<body([^>]*)>", drawn[0])
    assert body
    facts = dict(re.findall(r'data-(\w+)="([^"]*)"', body[1]))
    assert facts["frames"] == "12"
    assert facts["visible"] == facts["expected"]
