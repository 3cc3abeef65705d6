"""A folder with a run of the shortened sample telescope."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from tests.cut_telescope import cut_telescope
from truing.pipeline.command_line import app


def make_workplace(place: Path) -> None:
    """``sample_data/telescope``, and ``runs/telescope`` as `truing run` leaves it."""
    campaign = cut_telescope(place / "sample_data" / "telescope")
    done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(place / "runs" / "telescope"), "--quiet"])
    assert done.exit_code == 0, done.output
