"""What all tests share: deterministic, bounded property tests, and the folder of real measurements."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.made_once import made_once

PROJECT = Path(__file__).resolve().parents[1]

settings.register_profile(
    "project",
    max_examples=25,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("project")


@pytest.fixture(scope="session")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``sample_data/telescope``, cut short, and its run ``runs/telescope``; not to be written to."""
    from tests.workplace import make_workplace

    return made_once(tmp_path_factory, "workplace", make_workplace)


@pytest.fixture(scope="session")
def sample_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of all of ``sample_data/telescope`` as far as its calibration; not to be written to."""
    from docs.experiments.calibration import run_sample

    return made_once(tmp_path_factory, "sample-run", lambda place: run_sample(place / "run", "calibrate")) / "run"


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real measurements, which are not ours to copy: a test that needs them skips without."""
    folder = Path(os.environ.get("TRUING_REAL_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real measurements in {folder}; TRUING_REAL_DATA names their folder")
    return folder
