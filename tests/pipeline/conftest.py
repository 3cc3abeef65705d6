"""Fixtures: a small project for each test, new or with a finished run."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.pipeline.fake_project import FakeProject, make_fake_project
from tests.pipeline.skeletons import assert_valid_if_activated
from tests.pipeline.warm_python import AVAILABLE, WarmPython
from truing.pipeline import campaign_template


@pytest.fixture(autouse=True)
def _skeletons_are_valid(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Every skeleton that `truing init` writes in a test is valid as it is and with its proposed lines active."""
    written: list[str] = []
    write = campaign_template.starter_text

    def kept(*arguments: Any, **named: Any) -> str:
        written.append(write(*arguments, **named))
        return written[-1]

    monkeypatch.setattr(campaign_template, "starter_text", kept)
    yield
    for text in written:
        assert_valid_if_activated(text)


@pytest.fixture(scope="session")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WarmPython | None]:
    """The Python that forks for every call, where the system can fork."""
    if not AVAILABLE:
        yield None
        return
    python = WarmPython(tmp_path_factory.mktemp("warm"))
    yield python
    python.close()


@pytest.fixture
def fake(tmp_path: Path, warm: WarmPython | None) -> FakeProject:
    """The tiny project, nothing run."""
    return make_fake_project(tmp_path, warm)


@pytest.fixture(scope="session")
def _run_once(tmp_path_factory: pytest.TempPathFactory, warm: WarmPython | None) -> FakeProject:
    project = make_fake_project(tmp_path_factory.mktemp("once"), warm)
    project.run()
    return project


@pytest.fixture
def ran(_run_once: FakeProject, tmp_path: Path) -> FakeProject:
    """The tiny project with a finished run: a copy, which by the laws of freshness is as good as the original."""
    once, folder = _run_once, _run_once.root.parent
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    places = (tmp_path / path.relative_to(folder) for path in (once.root, once.campaign, once.cwd))
    return FakeProject(*places, once.warm)
