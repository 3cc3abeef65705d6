"""Damaged, mixed, incomplete or newer runs are refused, with one line per fault."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode

_WRITTEN = "expected the file unchanged since its stage wrote it; `truing run` writes it again"


def _cut(name: str) -> Callable[[Path], object]:
    return lambda run: (run / name).write_bytes((run / name).read_bytes()[:-90])


def _telling(**stated: str) -> Callable[[Path], object]:
    """Quality checks with other metadata on their origin; an empty word removes one."""

    def change(run: Path) -> None:
        table = pq.read_table(run / "qa.parquet")
        more = {f"truing.{name}".encode(): word.encode() for name, word in stated.items()}
        metadata = {**table.schema.metadata, **more}
        kept = {name: word for name, word in metadata.items() if word}
        pq.write_table(table.replace_schema_metadata(kept), run / "qa.parquet")

    return change


def _fewer_rows(run: Path) -> None:
    table = pq.read_table(run / "qa.parquet")
    pq.write_table(table.slice(1), run / "qa.parquet")


def _half(run: Path) -> None:
    """As a run leaves it that was ended after its first stage had read other points."""
    ledger = json.loads((run / ".truing" / "ledger.json").read_text())
    ledger["entries"]["qa"]["made_from"]["inputs"]["observations"] = "0" * 64
    (run / ".truing" / "ledger.json").write_text(json.dumps(ledger))


def _copied(change: Callable[[Path], object]) -> Callable[[Path], None]:
    """The same of tables that were copied without the run's ledger."""

    def both(run: Path) -> None:
        shutil.rmtree(run / ".truing")
        change(run)

    return both


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "cut short": (_cut("poses.parquet"), "poses.parquet: expected an undamaged Parquet file"),
    "empty": (lambda run: (run / "poses.parquet").write_bytes(b""), "poses.parquet: expected an undamaged"),
    "missing": (lambda run: (run / "diagnosis.parquet").unlink(), "diagnosis.parquet: expected this file"),
    "fewer rows": (_fewer_rows, f"qa.parquet: {_WRITTEN}"),
    "half a run": (_half, "a complete run; qa was made from other tables than these"),
    "of a later version": (
        _telling(schema_version="99", software_version="9.9"),
        "version 99 of its schema, by truing",
    ),
    "without origin": (_telling(digest=""), "qa.parquet: found no complete provenance"),
    "of nonsense": (_telling(units="[", schema_version="x"), "qa.parquet: found no complete provenance"),
    "its model cut short": (_cut("model.toml"), f"model.toml: {_WRITTEN}"),
    "its model another text": (
        _copied(lambda run: (run / "model.toml").write_text("model = 3\n")),
        "a model.toml that `truing run` has written",
    ),
    "its model too deep": (
        _copied(lambda run: (run / "model.toml").write_text(f"model = {'[' * 9000}")),
        "a model.toml that `truing run` has written",
    ),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_run_is_reported(name: str, workplace: Path, tmp_path: Path) -> None:
    words = ("compare", "whole") if name in ("cut short", "half a run") else ("export",)  # both open runs by one way
    damage, reported = DAMAGES[name]
    shutil.copytree(workplace / "runs" / "telescope", tmp_path / "damaged")
    damage(tmp_path / "damaged")
    others = [str(workplace / "runs" / "telescope") for _ in words[1:]]
    command = [words[0], *others, str(tmp_path / "damaged"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == ExitCode.UNUSABLE_CAMPAIGN, done.output
    assert reported in done.output
    assert "Traceback" not in done.output
    assert not (tmp_path / "out").exists()
