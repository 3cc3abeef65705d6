"""Laws of `truing check` on a damaged campaign, whatever the damage."""

from __future__ import annotations

import hashlib
import io
import re
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from hypothesis import strategies as st
from typer.testing import CliRunner

from tests.broken.mutations import column_damages, damaged, damages
from tests.broken.subjects import Subject, good_files
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode

_MAY_END = (ExitCode.DONE, ExitCode.UNUSABLE_CAMPAIGN)
_SECONDS = 5.0  # of the processor; a good campaign takes a tenth of one
_LONGEST = 1500  # characters of a line: a message, not the file
_FAULT = re.compile(r".+: (found .*; )?expected .+", re.DOTALL)


Files = Callable[[str], dict[str, bytes]]  # by campaign


def contents(subject: Subject, files: Files = good_files) -> st.SearchStrategy[bytes]:
    """The subject's file, damaged."""
    good = files(subject.campaign)[subject.file]
    if subject.form != "parquet":
        return damages(subject.form).map(lambda those: damaged(good, those))
    table = pq.read_table(io.BytesIO(good))
    return column_damages().map(lambda those: _written(table, those))


def _written(table: pa.Table, those: tuple) -> bytes:
    for damage in those:
        table = damage.applied(table)
    out = io.BytesIO()
    try:
        pq.write_table(table, out)
    except (pa.ArrowNotImplementedError, pa.ArrowInvalid):  # what Parquet does not know
        return b""
    return out.getvalue()


def lay_out(subject: Subject, folder: Path, content: bytes, files: Files = good_files) -> None:
    """The campaign in an existing folder, the subject's file with this content."""
    for name, good in files(subject.campaign).items():
        (folder / name).write_bytes(content if name == subject.file else good)
    if subject.command == "init":
        (folder / "campaign.toml").unlink()


def _words(command: str, folder: Path) -> list[str]:
    if command == "predict":
        inputs = "configurations.csv" if (folder / "configurations.csv").exists() else "interferometer.csv"
        return [command, str(folder / "model.toml"), str(folder / inputs)]
    more = ["--to", "json,controller", "--out", str(folder) + "-exports"] if command == "export" else []
    return [command, str(folder), *more]


def misbehaviour(folder: Path, command: str = "check") -> str | None:
    """Return the misbehaviour of a command on a campaign or a run, or None. Warnings must be errors."""
    before = _state(folder)
    started = time.process_time()
    done = CliRunner().invoke(app, _words(command, folder))
    took = time.process_time() - started
    if done.exit_code not in _MAY_END:
        return f"exit code {done.exit_code}: {done.output[-3000:]}"
    if "Traceback" in done.output or "Warning" in done.output:
        return f"says {done.output[:3000]}"
    if took > _SECONDS:
        return f"took {took:.1f} s"
    if command == "init" and not done.exit_code:
        tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))
        (folder / "campaign.toml").unlink()
    if _state(folder) != before:
        return "changed the campaign's folder"
    return _unclear(done.stderr) if done.exit_code else None


def _unclear(said: str) -> str | None:
    lines = said.splitlines()
    if not lines:
        return "refused without a word"
    wrong = [line for line in lines if not _FAULT.fullmatch(line) or len(line) > _LONGEST]
    return f"unclear: {wrong[0][:500]}" if wrong else None


def _state(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}
