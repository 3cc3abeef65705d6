"""A whole run writes into its folder and the system's place for temporary files, and nowhere else."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from pipeline.command_line import app
from tests.cut_telescope import cut_telescope

_CHANGING = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.truncate", "os.chmod"}
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_TRUNC


class _Watch:
    """Every path that is opened for writing, renamed, removed, made or linked, as the interpreter tells it."""

    def __init__(self) -> None:
        self.is_on, self.touched = True, set[Path]()
        sys.addaudithook(self._note)  # which cannot be taken away again, only fall silent

    def _note(self, event: str, words: tuple[Any, ...]) -> None:
        if not self.is_on:
            return
        if event == "open" and not isinstance(words[0], int):
            if set(str(words[1] or "")) & set("wax+") or (words[2] or 0) & _WRITING:
                self._add(words[:1])
        elif event in _CHANGING:
            self._add(words[:2])

    def _add(self, names: tuple[Any, ...]) -> None:
        paths = (name for name in names if isinstance(name, str | bytes | os.PathLike))
        self.touched.update(Path(os.path.abspath(os.fsdecode(path))) for path in paths)


def test_every_path_that_is_written_lies_in_the_run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = cut_telescope(tmp_path / "campaign")
    table = campaign / "configurations.csv"
    table.write_text(table.read_text().replace("calibration", "verification"))  # all stages, and little to search for
    for name in ("here", "temporary"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    watch = _Watch()
    try:
        done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(tmp_path / "run"), "--quiet"])
    finally:
        watch.is_on = False
    assert done.exit_code in (0, 3), done.output
    assert tmp_path / "run" / "report.html" in watch.touched  # the watch works
    allowed = (tmp_path / "run", tmp_path / "temporary")
    # what is compiled (by Python and by numba) is kept beside its source, and is no result of a run
    foreign = [path for path in watch.touched if not any(map(path.is_relative_to, allowed))]
    assert [path for path in foreign if "__pycache__" not in path.parts and path != Path(os.devnull)] == []
    assert {path.name for path in tmp_path.iterdir()} == {"campaign", "here", "temporary", "run"}
    assert not [*(tmp_path / "here").iterdir(), *(tmp_path / "temporary").iterdir()]
