"""A run writes only to its folder and the temporary folder, and each command only where it says.

What is compiled (by Python and by numba) is kept next to its source, and is no result of a run.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.cut_telescope import cut_telescope
from truing.pipeline.command_line import app

_CHANGING = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.truncate", "os.chmod"}
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_TRUNC


class _Watch:
    """Every path that is opened for writing, renamed, removed, made or linked, as the interpreter reports it."""

    def __init__(self) -> None:
        self.touched = set[Path]()

    def note(self, event: str, words: tuple[Any, ...]) -> None:
        if event == "open" and not isinstance(words[0], int):
            if set(str(words[1] or "")) & set("wax+") or (words[2] or 0) & _WRITING:
                self._add(words[:1])
        elif event in _CHANGING:
            self._add(words[:2])

    def _add(self, names: tuple[Any, ...]) -> None:
        paths = (name for name in names if isinstance(name, str | bytes | os.PathLike))
        self.touched.update(Path(os.path.abspath(os.fsdecode(path))) for path in paths)


_WATCHES: list[_Watch] = []  # those at work


@cache
def _listen() -> None:
    """Let watches at work know of every event. A hook stays to the end of the process: only one is installed."""

    def hook(event: str, words: tuple[Any, ...]) -> None:
        for watch in _WATCHES:
            watch.note(event, words)

    sys.addaudithook(hook)


def _foreign(watch: _Watch, *allowed: Path) -> list[Path]:
    """Touched paths outside the allowed places."""
    allowed = (*allowed, Path("/proc/self"))  # counters of this process
    foreign = [path for path in watch.touched if not any(map(path.is_relative_to, allowed))]
    return [path for path in foreign if "__pycache__" not in path.parts and path != Path(os.devnull)]


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with ``here``, where a person stands, ``temporary`` and ``home``, all empty."""
    for name in ("here", "temporary", "home"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    return tmp_path


def _called(*words: object) -> _Watch:
    watch = _Watch()
    _listen()
    _WATCHES.append(watch)
    try:
        done = CliRunner().invoke(app, [str(word) for word in words])
    finally:
        _WATCHES.remove(watch)
    assert done.exit_code in (0, 3), done.output
    return watch


def _left(places: Path) -> set[str]:
    """Names in a place, except three folders that must be empty."""
    for name in ("here", "temporary", "home"):
        assert list((places / name).iterdir()) == []
    return {path.name for path in places.iterdir()} - {"here", "temporary", "home"}


def test_every_path_that_is_written_lies_in_the_run_folder(places: Path) -> None:
    campaign = cut_telescope(places / "campaign")
    table = campaign / "configurations.csv"
    table.write_text(table.read_text().replace("calibration", "verification"))  # all stages, and little to search for
    watch = _called("run", campaign, "--out", places / "run", "--quiet")
    assert places / "run" / "report.html" in watch.touched  # the watch works
    assert _foreign(watch, places / "run", places / "temporary") == []
    assert _left(places) == {"campaign", "run"}


def _of_other_points(run: Path, copy: Path) -> Path:
    """A copy of a run's tables that says that other points were measured."""
    shutil.copytree(run, copy, ignore=shutil.ignore_patterns(".truing", "exports", "report.html"))
    table = pq.read_table(copy / "observations.parquet")
    metadata = {**table.schema.metadata, b"truing.digest": b"0" * 64}
    pq.write_table(table.replace_schema_metadata(metadata), copy / "observations.parquet")
    return copy


def test_every_other_command_writes_where_it_says(places: Path, workplace: Path) -> None:
    run = Path(shutil.copytree(workplace / "runs" / "telescope", places / "run"))
    campaign = Path(shutil.copytree(workplace / "sample_data" / "telescope", places / "campaign"))
    other, raw = _of_other_points(run, places / "other"), places / "raw"
    raw.mkdir()
    (raw / "points.csv").write_bytes((campaign / "points.csv").read_bytes())
    readings = campaign / "configurations.csv"
    calls: tuple[tuple[tuple[object, ...], str | None], ...] = (
        (("check", campaign), None),
        (("stages", campaign, "--out", run), None),
        (("init", raw), "raw/campaign.toml"),
        (("export", run, "--to", "csv,controller"), "run/exports"),
        (("compare", run, other), "comparison"),
        (("predict", run / "model.toml", readings, "--out", places / "poses.parquet"), "poses.parquet"),
    )
    for words, place in calls:
        watch = _called(*words)
        parts = () if place is None else (places / place, (places / place).with_name(f".{Path(place).name}.part"))
        assert _foreign(watch, places / "temporary", *parts) == [], words
        assert place is None or (places / place).exists()
    assert _left(places) == {"campaign", "run", "other", "raw", "comparison", "poses.parquet"}
    assert not list(places.rglob("*.part"))


def test_compiled_code_is_kept_next_to_its_source_or_not_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """The user's home folder is not used for an installation by an administrator."""
    from truing.compiled_code import compiled

    def same(value: float) -> float:
        return value

    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    assert compiled(__file__)(same)._cache.cache_path is not None  # type: ignore[attr-defined]
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert compiled(__file__)(same)._cache.cache_path is None  # type: ignore[attr-defined]
