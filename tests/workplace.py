"""A folder in which a person has run the sample telescope, cut short: made once, whichever worker asks first."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pipeline.command_line import app
from pipeline.lock import hold
from pipeline.problems import EnvironmentProblem
from pipeline.stage_order import stage_module
from tests.cut_telescope import cut_telescope

_WORKER_ASKS_AGAIN_S = 0.1


def make_workplace(place: Path) -> None:
    """``sample_data/telescope``, and ``runs/telescope`` as `truing run` leaves it, with fewer draws of its tests."""
    campaign = cut_telescope(place / "sample_data" / "telescope")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stage_module("diagnose"), "DRAWS", 50, raising=False)
        done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(place / "runs" / "telescope"), "--quiet"])
    assert done.exit_code == 0, done.output


def shared_workplace(shared: Path) -> Path:
    """The folder in one that all workers share; who comes second waits for who came first."""
    place, whole = shared / "workplace", shared / "workplace" / "whole"
    place.mkdir(exist_ok=True)
    while not whole.exists():
        try:
            with hold(shared / "workplace.lock"):
                if not whole.exists():
                    make_workplace(place)
                    whole.touch()
        except EnvironmentProblem:
            time.sleep(_WORKER_ASKS_AGAIN_S)
    return place
