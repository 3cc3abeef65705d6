"""What all tests share: deterministic, bounded property tests, and the folder of real measurements."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

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
    from tests.workplace import shared_workplace

    own = tmp_path_factory.getbasetemp()
    return shared_workplace(own.parent if "PYTEST_XDIST_WORKER" in os.environ else own)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real measurements, which are not ours to copy: a test that needs them skips without."""
    folder = Path(os.environ.get("TRUING_REAL_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real measurements in {folder}; TRUING_REAL_DATA names their folder")
    return folder
