"""Files of a campaign and of its run that change before or while it runs."""

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

Act = Callable[[Path, Path], object]  # on the campaign's folder and the run's
_DURING = CampaignRun.outcome


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


def _without_place(campaign: Path, run: Path) -> None:
    (run / "qa.parquet").mkdir()


CHANGES: dict[str, tuple[str, Act, ExitCode, str]] = {
    "campaign vanishes": ("ingest", lambda c, r: shutil.rmtree(c), ExitCode.UNUSABLE_CAMPAIGN, "expected this file"),
    "raw file is written to": ("ingest", _shortened, ExitCode.ENVIRONMENT, "points.csv changed or disappeared"),
    "run vanishes": ("qa", lambda c, r: shutil.rmtree(r), ExitCode.ENVIRONMENT, "was changed after it was written"),
    "run vanishes at once": ("ingest", lambda c, r: shutil.rmtree(r), ExitCode.ENVIRONMENT, "run has disappeared"),
    "table is cut short": ("qa", _halved, ExitCode.ENVIRONMENT, "was changed after it was written"),
    "a folder in a table's place": ("qa", _without_place, ExitCode.ENVIRONMENT, "qa.parquet cannot be renamed"),
}


@pytest.mark.skipif(sys.platform == "win32", reason="open files cannot be removed there")
@pytest.mark.parametrize("name", CHANGES)
def test_a_change_during_a_run_is_named_and_mended_by_the_next_run(
    name: str, campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage, act, code, says = CHANGES[name]
    kept = shutil.copytree(campaign, tmp_path / "kept")

    def outcome(self: CampaignRun, about: object, progress: object) -> object:
        if about.name == stage:  # type: ignore[attr-defined]
            act(campaign, tmp_path / "run")
        return _DURING(self, about, progress)  # type: ignore[arg-type]

    monkeypatch.setattr(CampaignRun, "outcome", outcome)
    ended, output = _run(campaign, tmp_path / "run")
    assert (ended, output.count("\n")) == (code, output.count("expected") or 1), output
    assert says in output
    assert not list(tmp_path.rglob("*.part"))
    monkeypatch.undo()
    shutil.rmtree(campaign, ignore_errors=True)
    shutil.copytree(kept, campaign)
    if (tmp_path / "run" / "qa.parquet").is_dir():
        (tmp_path / "run" / "qa.parquet").rmdir()
    assert _run(campaign, tmp_path / "run") == (ExitCode.DONE, "")


def _entry(**told: object) -> Act:
    """The ledger's entry of ingest, changed."""

    def act(campaign: Path, run: Path) -> None:
        ledger = json.loads((run / ".truing" / "ledger.json").read_text())
        ledger["entries"]["ingest"] |= told
        (run / ".truing" / "ledger.json").write_text(json.dumps(ledger))

    return act


def _private(name: str, text: str) -> Act:
    return lambda campaign, run: (run / ".truing" / name).write_text(text)


def _carrying(**told: str) -> Act:
    """The ledger gone, and a table that tells other things of itself than were written."""

    def act(campaign: Path, run: Path) -> None:
        shutil.rmtree(run / ".truing")
        table = pq.read_table(run / "observations.parquet")
        more = {f"truing.{key}".encode(): value.encode() for key, value in told.items()}
        pq.write_table(table.replace_schema_metadata({**table.schema.metadata, **more}), run / "observations.parquet")

    return act


def _piped(campaign: Path, run: Path) -> None:
    (run / ".truing" / "ledger.json").unlink()
    os.mkfifo(run / ".truing" / "ledger.json")


LEFT: dict[str, Act] = {
    "ledger of a later version": _entry(artifacts={"observations": "00", "of-tomorrow": "00"}),
    "ledger of another form": _entry(artifacts=["observations"]),
    "ledger of other origins": _entry(made_from={"campaign": 1, "source": [1], "settings": 2, "inputs": [], "raw": 0}),
    "ledger too deep": _private("ledger.json", "[" * 100_000),
    "digests of another form": _private("digests.json", '{"files": {"a": 3}, "facts": {"imports": 7}}'),
    "digests too deep": _private("digests.json", "[" * 100_000),
    "table of a later version": _carrying(left='["of-tomorrow"]'),
    "table that tells nonsense": _carrying(left="{", failed_checks="7"),
} | ({} if sys.platform == "win32" else {"a pipe for a ledger": _piped})


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``campaign`` and its ``run``."""
    place = tmp_path_factory.mktemp("ran")
    assert _run(cut_telescope(place / "campaign"), place / "run", "ingest") == (ExitCode.DONE, "")
    return place


@pytest.mark.parametrize("name", LEFT)
def test_a_run_is_completed_whatever_its_folder_holds(name: str, ran: Path, tmp_path: Path) -> None:
    shutil.copytree(ran / "run", tmp_path / "run")
    LEFT[name](ran / "campaign", tmp_path / "run")
    assert _run(ran / "campaign", tmp_path / "run", "ingest") == (ExitCode.DONE, "")
    made, first = (pq.read_table(place / "run" / "observations.parquet") for place in (tmp_path, ran))
    assert made.equals(first)


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_a_run_folder_that_is_a_link_in_a_circle(campaign: Path, tmp_path: Path) -> None:
    (tmp_path / "run").symlink_to("run")
    ended, output = _run(campaign, tmp_path / "run")
    assert (ended, output.count("\n")) == (ExitCode.ENVIRONMENT, 1)
