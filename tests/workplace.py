"""Folders with a run of the shortened sample telescope, and of the sample robot."""

from __future__ import annotations

import shutil
from pathlib import Path

from typer.testing import CliRunner

from tests.cut_telescope import cut_telescope
from truing.pipeline.command_line import app

SAMPLE_DATA = Path(__file__).resolve().parents[1] / "sample_data"


def make_workplace(place: Path) -> None:
    """``sample_data/telescope``, and ``runs/telescope`` as `truing run` leaves it."""
    campaign = cut_telescope(place / "sample_data" / "telescope")
    done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(place / "runs" / "telescope"), "--quiet"])
    assert done.exit_code == 0, done.output


def run_robot(place: Path) -> None:
    """``robot``, a copy of ``sample_data/robot``, and ``run``, its run as far as the diagnosis."""
    campaign = Path(shutil.copytree(SAMPLE_DATA / "robot", place / "robot"))
    words = ["run", str(campaign), "--out", str(place / "run"), "--only", "diagnose", "--quiet"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
