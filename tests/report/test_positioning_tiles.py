"""The top of a page of positioning runs tells the accuracy of the axis."""

from __future__ import annotations

import pandas as pd

from truing.report.head import build_head


def test_accuracy_and_reversal_of_an_axis_stand_at_the_top():
    rows = [("X", "B", "25 mm", 0.5), ("X", "A", None, 2.5197), ("X", "B", None, 0.59), ("X", "R", None, 0.8)]
    table = pd.DataFrame(rows, columns=["run", "figure", "subject", "value"]).assign(unit="um")
    head = build_head("stage", {"positioning": table})
    assert dict(head.tiles) == {"accuracy A, X": "2.52 µm", "reversal B, X": "0.590 µm"}
