"""A figure has the project's template wherever it was made."""

from __future__ import annotations

import plotly.graph_objects as go
import plotly.io as pio
import pytest

from truing.report.figure_style import figure_template, style


def test_a_figure_made_outside_of_the_context_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    with figure_template():
        within = style(go.Figure(), "title", "subtitle", 300)
    with monkeypatch.context() as patch:
        patch.setattr(pio.templates, "_default", "plotly")
        outside = style(go.Figure(), "title", "subtitle", 300)
    assert outside == within
