"""Slips in single columns of an axis are reported with their column, on axes drawn at random; honest ones pass."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.belonging.axis_slips import slips
from tests.blind.generator.axis import AxisLayout, draw_layout, draw_one, record, write
from truing.pipeline.in_memory import stage_line

# Exchanged columns show only if an effect, exact commands or counts tell them apart. A shift of nearly equal steps
# resembles lost motion.
HIDDEN = ("exchanged", "shifted by -2")


def messages(folder: Path) -> list[str]:
    """Check, subject and message of each failed check."""
    checks = stage_line(str(folder)).call("ingest", "qa").tables["qa"].to_pylist()
    return [f"{row['check']} {row['subject']}: {row['message']}" for row in checks if row["verdict"] == "fail"]


def made(seed: int, folder: Path) -> AxisLayout:
    """A drawn axis, every second one with an error."""
    rng = np.random.default_rng(seed)
    causes = ("lost-motion", "periodic-error", "scale-error")
    layout, hidden = draw_one(causes[seed % 3], 12.0, rng) if seed % 2 else (draw_layout(rng), None)
    write(record(layout, () if hidden is None else (hidden,), rng), folder)
    return layout


@pytest.mark.parametrize("seed", range(700, 704))
def test_slips_of_columns_are_reported_with_their_column(tmp_path: Path, seed: int) -> None:
    folder = tmp_path / "axis"
    layout = made(seed, folder)
    honest = pd.read_csv(folder / "configurations.csv")
    assert messages(folder) == []
    tried = [
        slip
        for slip in slips(layout.unit, layout.channels, layout.loop)
        if not any(word in slip.name for word in HIDDEN)
    ]
    for slip in tried:
        table = honest.copy()
        slip.change(table, np.random.default_rng(seed))
        table.to_csv(folder / "configurations.csv", index=False)
        reported = messages(folder)
        assert all(any(column in text for text in reported) for column in slip.columns), (slip.name, reported)
        assert any(all(word in text for word in slip.words) for text in reported), (slip.name, reported)


@pytest.mark.parametrize("seed", range(720, 732))
def test_honest_axes_pass(tmp_path: Path, seed: int) -> None:
    made(seed, tmp_path / "axis")
    assert messages(tmp_path / "axis") == []
