"""Fixture: a photographed machine of three poses, adjusted once for all tests."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from tests.photographs.machine import LINE, drawn_again, photograph
from tests.photographs.rays import Photographed
from tests.stages.line import run_line, settings_of
from truing.pipeline.in_memory import call_stage


@pytest.fixture(scope="session")
def adjusted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Photographed, Path, dict[str, pa.Table]]:
    """The photographed campaign, its folder, and every table of its line; not to be written to."""
    folder = tmp_path_factory.mktemp("rays") / "machine"
    photographed = photograph(folder)
    return photographed, folder, run_line(folder, *LINE)[0]


@pytest.fixture(scope="session")
def drawn(adjusted: tuple[Photographed, Path, dict[str, pa.Table]]) -> dict[str, pa.Table]:
    """One pose a hundred times, its points drawn from their whole covariance, with its poses and shifts.

    Errors common to all poses are drawn anew for each.
    """
    _, folder, tables = adjusted
    again, settings = drawn_again(tables, pose=1, times=100), settings_of(folder)
    del again["point_sensitivities"]
    for stage in ("pose", "deformation"):
        again |= call_stage(stage, again, settings).artifacts  # type: ignore[operator]
    return again
