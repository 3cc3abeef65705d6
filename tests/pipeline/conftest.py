"""A tiny project of its own for every test that asks, freshly laid out or with a run behind it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.pipeline.fake_project import FakeProject, make_fake_project


@pytest.fixture
def fake(tmp_path: Path) -> FakeProject:
    """The tiny project, nothing run."""
    return make_fake_project(tmp_path)


@pytest.fixture(scope="session")
def _run_once(tmp_path_factory: pytest.TempPathFactory) -> FakeProject:
    project = make_fake_project(tmp_path_factory.mktemp("once"))
    project.run()
    return project


@pytest.fixture
def ran(_run_once: FakeProject, tmp_path: Path) -> FakeProject:
    """The tiny project with a finished run: a copy, which by the laws of freshness is as good as the original."""
    folder = _run_once.root.parent
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    return FakeProject(
        *(tmp_path / path.relative_to(folder) for path in (_run_once.root, _run_once.campaign, _run_once.cwd))
    )
