"""Common style of all figures: colours, titles, and axes that stay readable with a thousand poses or an outlier."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io as pio
from numpy.typing import ArrayLike, NDArray
from plotly.subplots import make_subplots

# Okabe-Ito colours, which colour-blind readers can distinguish.
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#7A7A7A"
# A value this many times the median would flatten all others on a linear axis.
_OUTSTANDING = 30.0
# More points than this are drawn by WebGL.
MANY_POINTS = 4000
_LABELS = 24
BAR = 1.96  # half length of a 95 % bar, in standard deviations
_TEMPLATE = "plotly_white"


@contextmanager
def figure_template() -> Iterator[None]:
    """Make plotly start each figure with the project's template, inside this context.

    A template that is set later is validated value by value, which takes as long as the rest of a figure.
    """
    before, pio.templates.default = pio.templates.default, _TEMPLATE
    try:
        yield
    finally:
        pio.templates.default = before


def style(figure: go.Figure, title: str, subtitle: str, height: int) -> go.Figure:
    """Set title, subtitle (the reading of the figure) and layout of a figure."""
    if pio.templates.default != _TEMPLATE:  # made outside of `figure_template`
        figure.update_layout(template=_TEMPLATE)
    figure.update_layout(
        title={
            "text": title,
            "subtitle": {"text": subtitle, "font": {"size": 12, "color": GREY}},
            "font": {"size": 15},
            "x": 0.0,
            "xanchor": "left",
            "y": 1.0,
            "yanchor": "top",
            "yref": "container",
            "pad": {"t": 8},
        },
        height=height,
        margin={"l": 60, "r": 20, "t": 84, "b": 50},
        font={"family": "system-ui, sans-serif", "size": 12},
        overwrite=True,  # merging with what is there takes eight times as long
    )
    return figure


def label(name: object) -> str:
    """Return a name from the data escaped for plotly, which reads its texts as markup."""
    return html.escape(str(name), quote=False)


def pose_axis(poses: ArrayLike) -> tuple[NDArray, dict[str, object]]:
    """Return places of poses along an axis, and the axis: numbered poses at their number, named ones in sequence."""
    identifiers = np.asarray(poses)
    if np.issubdtype(identifiers.dtype, np.number):
        return identifiers, {"title": {"text": "pose"}}
    names, first = np.unique(identifiers.astype(str), return_index=True)
    ordered = names[np.argsort(first)]
    index_of = {name: k for k, name in enumerate(ordered)}
    shown = np.arange(0, len(ordered), max(1, -(-len(ordered) // _LABELS)))
    ticks = {"tickvals": shown.tolist(), "ticktext": [label(_short(ordered[k])) for k in shown], "tickangle": -60}
    return np.array([index_of[str(pose)] for pose in identifiers]), {
        "title": {"text": "pose"},
        "automargin": True,
        **ticks,
    }


def _short(name: str) -> str:
    return name if len(name) <= 20 else f"{name[:9]}…{name[-9:]}"


def size_axis(values: ArrayLike) -> dict[str, object]:
    """Return an axis for sizes: from zero, or logarithmic if a few are much larger than the rest."""
    sizes = np.asarray(values, dtype=float)
    sizes = sizes[np.isfinite(sizes) & (sizes > 0.0)]
    if len(sizes) and sizes.max() > _OUTSTANDING * np.median(sizes):
        return {"type": "log", "dtick": "D2" if sizes.max() < 1e3 * sizes.min() else 1}
    return {"rangemode": "tozero"}


def sequence_title(title: str, logarithmic: bool) -> str:
    """Return an axis title that names a logarithmic scale."""
    return f"{title}, log scale" if logarithmic else title


def panel_grid(
    titles: Sequence[str], most: int, gaps: tuple[float, Callable[[int], float]], size: int = 13, **shared: Any
) -> tuple[go.Figure, list[dict[str, int]], int]:
    """Return a figure with titled panels, at most ``most`` side by side, the place of each panel, and the number of
    rows.

    ``gaps``: between columns, and between rows by the number of rows, as shares of the figure.
    """
    columns = min(most, len(titles))
    rows = -(-len(titles) // columns)
    spacing = {"horizontal_spacing": gaps[0], "vertical_spacing": gaps[1](rows)}
    grid = make_subplots(rows=rows, cols=columns, subplot_titles=list(titles), **spacing, **shared)
    grid.update_annotations(font={"size": size})
    return grid, [{"row": k // columns + 1, "col": k % columns + 1} for k in range(len(titles))], rows
