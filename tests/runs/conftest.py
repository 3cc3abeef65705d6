"""A run of a small telescope, as `truing run` leaves it."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from pipeline.command_line import app
from tests.cut_telescope import cut_telescope


@pytest.fixture(scope="session")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``sample_data/telescope``, cut short, and its run ``runs/telescope``."""
    place = tmp_path_factory.mktemp("workplace")
    (place / "sample_data").mkdir()
    campaign = cut_telescope(place / "sample_data" / "telescope")
    done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(place / "runs" / "telescope"), "--quiet"])
    assert done.exit_code == 0, done.output
    return place
