"""Settings and fixtures of all tests: property tests, the mark of slow tests, runs of the sample, measured data."""

from __future__ import annotations

import gc
import os
import sys
from functools import cache
from pathlib import Path

import pytest
import typer.testing
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers

from tests.cpu_time import CpuTime
from tests.made_once import made_once

PROJECT = Path(__file__).resolve().parents[1]

# Tests run side by side: threads of products of matrices would wait for each other, a hundred times as long.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

# Each worker, and each of some hundred processes that tests start, would otherwise compile the same sources again.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Each call of `CliRunner.invoke` builds the same commands from signatures again, which takes longer than many calls.
typer.testing._get_command = cache(typer.testing._get_command)

# Hypothesis would parse every module of the project that was imported, for constants to draw: examples would depend on
# which other tests are collected.
providers._get_local_constants = lambda: providers._local_constants

settings.register_profile(
    "project",
    max_examples=25,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("quick", parent=settings.get_profile("project"), max_examples=1)
settings.load_profile("project")

TESTS = Path(__file__).resolve().parent
# All tests of these folders and files are marked slow: they search hidden campaigns, render photographs, damage files
# at random, run pages, compile large kernels, write certificates or start a browser. So are tests with these fixtures.
# Other slow tests bear the mark themselves.
SLOW = (
    "blind", "broken", "docs", "estimation/bundle/test_large_benchmark.py", "estimation/image_targets",
    "estimation/rigid_poses/test_batched_kernel.py", "photographs", "real", "report/test_in_browser.py",
    "runs/test_certificate.py", "runs/test_comparison.py", "second_hand",
    "simulation/bench/test_recovery.py", "simulation/mechanisms/test_recalibration.py", "stages/photographs",
)  # fmt: skip
SLOW_FIXTURES = {"browser", "real_data", "sample_run"}
# Files with the longest fixtures and tests (25 to 200 s), which begin first: a worker that began one of them last would
# work alone at the end. tests/cpu_time.py prints what takes long.
LONGEST = (
    "real/test_real_data.py", "blind/test_blind.py", "blind/test_blind_axes.py", "blind/test_blind_arms.py",
    "runs/test_chain_runs_compared.py", "docs/test_site.py", "blind/test_arm_cases.py",
    "blind/test_power_finds_as_much.py",
)  # fmt: skip


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(CpuTime(), "cpu-time")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests of slow folders and fixtures, and begin with the longest; `make quick` keeps one example of each
    law."""
    for item in items:
        if _in_slow_folder(item.path) or SLOW_FIXTURES & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.slow)
    rank = {TESTS / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path, len(rank)))
    if config.getoption("hypothesis_profile", None) == "quick":
        first = {item.nodeid.partition("[")[0]: item for item in reversed(items)}
        kept = [item for item in items if first[item.nodeid.partition("[")[0]] is item]
        config.hook.pytest_deselected(items=[item for item in items if item not in set(kept)])
        items[:] = kept


@cache
def _in_slow_folder(path: Path) -> bool:
    return any(path.is_relative_to(TESTS / name) for name in SLOW)


def pytest_collection_finish() -> None:
    """Exempt modules and collected tests from garbage collection: they live to the end, and scans take time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)  # as the command line does (pipeline/entry.py)


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
def robot_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``robot``, a copy of ``sample_data/robot``, and ``run``, its run as far as the diagnosis; not to be
    written to."""
    from tests.workplace import run_robot

    return made_once(tmp_path_factory, "robot-run", run_robot)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real measurements, which are not ours to copy: a test that needs them skips without."""
    folder = Path(os.environ.get("TRUING_REAL_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real measurements in {folder}; TRUING_REAL_DATA names their folder")
    return folder
