"""Runs are completed, or end with a message, if files of the campaign or of its run folder change meanwhile."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.cut_telescope import cut_telescope
from truing.pipeline.campaign_run import CampaignRun
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode

Change = Callable[[Path, Path], object]  # on the campaign's folder and the run's
_OUTCOME = CampaignRun.outcome


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    return cut_telescope(tmp_path / "campaign")


def _run(campaign: Path, run: Path, until: str = "qa") -> tuple[int, str]:
    done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(run), "--quiet", "--only", until])
    assert "Traceback" not in done.output
    return done.exit_code, done.output


def _shortened(campaign: Path, run: Path) -> None:
    table = campaign / "points.csv"
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:-1]))


def _halved(campaign: Path, run: Path) -> None:
    table = run / "observations.parquet"
    table.write_bytes(table.read_bytes()[: table.stat().st_size // 2])


def _with_folder_as_table(campaign: Path, run: Path) -> None:
    (run / "qa.parquet").mkdir()


CHANGES: dict[str, tuple[str, Change, ExitCode, str]] = {
    "campaign vanishes": ("ingest", lambda c, r: shutil.rmtree(c), ExitCode.UNUSABLE_CAMPAIGN, "expected this file"),
    "raw file is written to": ("ingest", _shortened, ExitCode.ENVIRONMENT, "points.csv changed or disappeared"),
    "run vanishes": ("qa", lambda c, r: shutil.rmtree(r), ExitCode.ENVIRONMENT, "was changed after it was written"),
    "run vanishes at once": ("ingest", lambda c, r: shutil.rmtree(r), ExitCode.ENVIRONMENT, "run has disappeared"),
    "table is cut short": ("qa", _halved, ExitCode.ENVIRONMENT, "was changed after it was written"),
    "a folder in a table's place": ("qa", _with_folder_as_table, ExitCode.ENVIRONMENT, "qa.parquet cannot be renamed"),
}


@pytest.mark.skipif(sys.platform == "win32", reason="open files cannot be removed there")
@pytest.mark.parametrize("name", CHANGES)
def test_a_change_during_a_run_is_named_and_mended_by_the_next_run(
    name: str, campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage, change, code, expected = CHANGES[name]
    kept = shutil.copytree(campaign, tmp_path / "kept")

    def outcome(self: CampaignRun, about: object, progress: object) -> object:
        if about.name == stage:  # type: ignore[attr-defined]
            change(campaign, tmp_path / "run")
        return _OUTCOME(self, about, progress)  # type: ignore[arg-type]

    monkeypatch.setattr(CampaignRun, "outcome", outcome)
    exit_code, output = _run(campaign, tmp_path / "run")
    assert (exit_code, output.count("\n")) == (code, output.count("expected") or 1), output
    assert expected in output
    assert not list(tmp_path.rglob("*.part"))
    monkeypatch.undo()
    shutil.rmtree(campaign, ignore_errors=True)
    shutil.copytree(kept, campaign)
    if (tmp_path / "run" / "qa.parquet").is_dir():
        (tmp_path / "run" / "qa.parquet").rmdir()
    assert _run(campaign, tmp_path / "run") == (ExitCode.DONE, "")


def _with_entry(**changed: object) -> Change:
    """Change the manifest's entry of ingest."""

    def change(campaign: Path, run: Path) -> None:
        ledger = json.loads((run / ".truing" / "ledger.json").read_text())
        ledger["entries"]["ingest"] |= changed
        (run / ".truing" / "ledger.json").write_text(json.dumps(ledger))

    return change


def _with_private_file(name: str, text: str) -> Change:
    return lambda campaign, run: (run / ".truing" / name).write_text(text)


def _with_table_facts(**changed: str) -> Change:
    """Remove the manifest, and change facts that a table states about itself."""

    def change(campaign: Path, run: Path) -> None:
        shutil.rmtree(run / ".truing")
        table = pq.read_table(run / "observations.parquet")
        more = {f"truing.{key}".encode(): value.encode() for key, value in changed.items()}
        pq.write_table(table.replace_schema_metadata({**table.schema.metadata, **more}), run / "observations.parquet")

    return change


def _with_pipe(campaign: Path, run: Path) -> None:
    (run / ".truing" / "ledger.json").unlink()
    os.mkfifo(run / ".truing" / "ledger.json")


FOLDERS: dict[str, Change] = {
    "ledger of a later version": _with_entry(artifacts={"observations": "00", "of-tomorrow": "00"}),
    "ledger of another form": _with_entry(artifacts=["observations"]),
    "ledger of other origins": _with_entry(
        made_from={"campaign": 1, "source": [1], "settings": 2, "inputs": [], "raw": 0}
    ),
    "ledger too deep": _with_private_file("ledger.json", "[" * 100_000),
    "digests of another form": _with_private_file("digests.json", '{"files": {"a": 3}, "facts": {"imports": 7}}'),
    "digests too deep": _with_private_file("digests.json", "[" * 100_000),
    "table of a later version": _with_table_facts(left='["of-tomorrow"]'),
    "table that tells nonsense": _with_table_facts(left="{", failed_checks="7"),
} | ({} if sys.platform == "win32" else {"a pipe for a ledger": _with_pipe})


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``campaign`` and its ``run``."""
    place = tmp_path_factory.mktemp("ran")
    assert _run(cut_telescope(place / "campaign"), place / "run", "ingest") == (ExitCode.DONE, "")
    return place


@pytest.mark.parametrize("name", FOLDERS)
def test_a_run_is_completed_whatever_its_folder_holds(name: str, finished_run: Path, tmp_path: Path) -> None:
    shutil.copytree(finished_run / "run", tmp_path / "run")
    FOLDERS[name](finished_run / "campaign", tmp_path / "run")
    assert _run(finished_run / "campaign", tmp_path / "run", "ingest") == (ExitCode.DONE, "")
    made, first = (pq.read_table(place / "run" / "observations.parquet") for place in (tmp_path, finished_run))
    assert made.equals(first)


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_a_run_folder_that_is_a_link_in_a_circle(campaign: Path, tmp_path: Path) -> None:
    (tmp_path / "run").symlink_to("run")
    exit_code, output = _run(campaign, tmp_path / "run")
    assert (exit_code, output.count("\n")) == (ExitCode.ENVIRONMENT, 1)
