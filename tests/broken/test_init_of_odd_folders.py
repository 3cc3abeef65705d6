"""`truing init` on arbitrary folders writes a readable campaign.toml, or one line with the reason."""

from __future__ import annotations

import gzip
import os
import sys
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode

_POINTS = b"pose,body,target,x_mm,y_mm,z_mm\n1,base,A,1,2,3\n"
_ANNOUNCES = b"ply\nformat ascii 1.0\nelement vertex 999999999999\nend_header\n"
_LINE = b"1" * 140_000  # more than Python's reader of CSV takes
FILES: dict[str, dict[str, bytes]] = {
    "nothing": {},
    "line breaks in a name": {"a\n[evil]\nx = 1.csv": _POINTS},
    "control characters in a column": {"a.csv": _POINTS.replace(b"x_mm", b"x\x01\x7f")},
    "a name that is no text": {"a\udcff.csv": _POINTS},
    "brackets in names": {f"p[1]a{n}.csv": _POINTS.replace(b"\n1,", b"\n%d," % n) for n in (1, 2)},
    "thousands of columns": {"a.csv": b",".join(b"c%d" % n for n in range(3000)) + b"\n"},
    "one endless cell": {"points.csv": _LINE},
    "a cloud that announces what it has not": {"a.ply": _ANNOUNCES},
    "an archive of nothing": {"a.csv.zip": b"PK\x05\x06" + b"\0" * 18},
    "no markers": {"a.c3d": b"\x02P" + b"\xff" * 600, "b.trc": b"PathFileType\t4\n\n\n\n\n"},
    "damaged Parquet": {"a.parquet": b"PAR1" + b"\xff" * 60 + b"PAR1"},
    "packed": {"points.csv.gz": gzip.compress(_POINTS)[:-9]},
}


@pytest.mark.skipif(sys.platform == "win32", reason="names may not hold these characters there")
@pytest.mark.parametrize("name", FILES)
def test_init_writes_what_check_can_read(name: str, tmp_path: Path) -> None:
    for file, content in FILES[name].items():
        (tmp_path / file).write_bytes(content)
    done = CliRunner().invoke(app, ["init", str(tmp_path)])
    assert done.exit_code == ExitCode.DONE, done.output
    assert max(map(len, done.output.splitlines())) < 1500
    tomllib.loads((tmp_path / "campaign.toml").read_text(encoding="utf-8"))
    checked = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert checked.exit_code == ExitCode.UNUSABLE_CAMPAIGN, checked.output
    assert "Traceback" not in checked.output
    assert "valid TOML" not in checked.output
    assert {path.name for path in tmp_path.iterdir()} == {*FILES[name], "campaign.toml"}


@pytest.mark.skipif(sys.platform == "win32", reason="needs pipes and links in the file system")
def test_pipes_devices_and_links_in_a_circle_are_passed_over(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "points.csv")
    (tmp_path / "targets.csv").symlink_to("/dev/zero")
    (tmp_path / "signals.csv").symlink_to("signals.csv")
    (tmp_path / "again").symlink_to(tmp_path)
    done = CliRunner().invoke(app, ["init", str(tmp_path)])
    assert (done.exit_code, done.output.count(".csv")) == (ExitCode.DONE, 0), done.output


def test_a_template_that_cannot_be_written_leaves_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a campaign.toml would stay for good, for it is never overwritten."""

    def written(*_: object) -> None:
        raise OSError(28, "No space left on device")

    opened = open

    def full(path: Path, mode: str = "r", *more: object, **words: object) -> object:
        file = opened(path, mode, *more, **words)  # type: ignore[call-overload]
        if mode == "xb":
            return _Full(file, written)
        return file

    monkeypatch.setattr("truing.pipeline.init_campaign.open", full, raising=False)
    done = CliRunner().invoke(app, ["init", str(tmp_path)])
    assert done.exit_code == ExitCode.ENVIRONMENT
    assert "the disk is full" in done.output
    assert list(tmp_path.iterdir()) == []


class _Full:
    """A file on a disk that is full."""

    def __init__(self, file: object, write: object) -> None:
        self._file, self.write = file, write

    def __enter__(self) -> _Full:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()  # type: ignore[attr-defined]
