"""No campaign overwrites the run of another; a moved, copied or corrected campaign keeps its own run."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from tests.pipeline.fake_project import STAGES, FakeProject
from tests.sentences import assert_says

OWN = "expected a separate folder"


def state(folder: Path) -> dict[str, bytes]:
    """All files of a run, but for its lock."""
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name != "lock"}


def another(fake: FakeProject, folder: str, name: str = "bench") -> Path:
    """A campaign with measurements of its own."""
    place = fake.campaign.parent / folder
    shutil.copytree(fake.campaign, place)
    fake.edit(place / "points.csv", "4.0", "5.0")
    fake.edit(place / "campaign.toml", '"bench"', f'"{name}"')
    return place


def refused(fake: FakeProject, *words: str) -> str:
    """Message of a refused call, which changes nothing."""
    before = state(fake.out)
    done = fake.call(*words)
    assert done.returncode == 2, done.stdout + done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert state(fake.out) == before
    return done.stderr


@pytest.fixture
def noted(ran: FakeProject) -> FakeProject:
    """A run folder that knows its campaign where both lie now: a copy asks for names alone until it is run."""
    assert ran.run() == []
    return ran


def test_another_campaign_into_a_run_folder_is_refused(noted: FakeProject) -> None:
    other = another(noted, "other", "telescope")
    for command in ("run", "stages"):
        output = refused(noted, command, str(other), "--out", str(noted.out))
        assert OWN in output
        assert str(noted.campaign / "campaign.toml") in output
        assert str(other / "campaign.toml") in output
        assert "--out" in output


def test_campaigns_of_equal_name_do_not_share_a_folder(noted: FakeProject) -> None:
    output = refused(noted, "run", str(another(noted, "other")))
    assert OWN in output
    assert "[campaign] name" in output
    assert noted.run() == []


def test_a_refused_campaign_runs_elsewhere_or_once_the_folder_is_removed(noted: FakeProject) -> None:
    other = another(noted, "other")
    assert noted.call("run", str(other), "--out", "elsewhere").returncode == 0
    shutil.rmtree(noted.out)
    assert noted.call("run", str(other)).returncode == 0
    assert OWN in refused(noted, "run", str(noted.campaign))


def test_a_corrected_campaign_keeps_its_folder(noted: FakeProject) -> None:
    noted.edit(noted.campaign / "points.csv", "4.0", "4.5")
    assert noted.run() == list(STAGES)
    noted.edit(noted.campaign / "campaign.toml", '"bench"', '"bench-2"')
    assert noted.run("--out", str(noted.out)) == list(STAGES)


@pytest.mark.parametrize("owner", ["noted", "unknown"])
def test_a_moved_campaign_keeps_its_folder(owner: str, noted: FakeProject) -> None:
    if owner == "unknown":
        forget_owner(noted)
    moved = replace(noted, campaign=noted.campaign.rename(noted.campaign.with_name("moved")))
    assert moved.run() == []
    moved.edit(moved.campaign / "points.csv", "4.0", "4.5")
    assert moved.run() == list(STAGES)


def test_a_copy_that_holds_the_same_is_the_same_campaign(noted: FakeProject) -> None:
    copy = replace(noted, campaign=shutil.copytree(noted.campaign, noted.campaign.with_name("copy")))
    assert copy.run() == []
    assert noted.run() == []


def test_a_project_that_was_copied_with_its_runs_goes_on_by_itself(noted: FakeProject, tmp_path: Path) -> None:
    place = tmp_path / "project of somebody"
    campaign, cwd = (Path(shutil.copytree(old, place / old.name)) for old in (noted.campaign, noted.cwd))
    copy = FakeProject(noted.root, campaign, cwd, noted.warm)
    copy.edit(campaign / "points.csv", "4.0", "4.5")
    assert copy.run() == list(STAGES)
    assert noted.run() == []


def forget_owner(fake: FakeProject) -> None:
    ledger = fake.out / ".truing" / "ledger.json"
    content = json.loads(ledger.read_text())
    del content["owner"]
    ledger.write_text(json.dumps(content))


def test_a_run_that_notes_no_owner_goes_on_for_its_name_alone(noted: FakeProject) -> None:
    forget_owner(noted)
    assert OWN in refused(noted, "run", str(another(noted, "other", "telescope")), "--out", str(noted.out))
    assert noted.run() == []
    assert OWN in refused(noted, "run", str(another(noted, "second")))


def test_a_run_without_its_ledger_is_known_by_its_artifacts(noted: FakeProject) -> None:
    shutil.rmtree(noted.out / ".truing")
    assert OWN in refused(noted, "run", str(another(noted, "other", "telescope")), "--out", str(noted.out))
    assert noted.run() == []


def test_files_that_no_run_has_left_are_not_overwritten(fake: FakeProject) -> None:
    place = fake.cwd / "mine"
    place.mkdir()
    for name in ("report.html", ".thesis.tex.part"):
        (place / name).write_text("months of work")
    before = state(place)
    done = fake.call("run", str(fake.campaign), "--out", "mine")
    assert done.returncode == 2
    assert "(report.html)" in done.stderr
    assert state(place) == before
    assert not (place / ".truing").exists()
    (place / "report.html").unlink()
    fake.run("--out", "mine")
    assert (place / ".thesis.tex.part").read_text() == "months of work"


def test_another_campaigns_folder_is_no_place_for_a_run(fake: FakeProject) -> None:
    other = another(fake, "other")
    before = state(other)
    done = fake.call("run", str(fake.campaign), "--out", str(other))
    assert done.returncode == 2
    assert "not a campaign's" in done.stderr
    assert state(other) == before


def test_a_folder_around_raw_files_is_no_place_for_a_run(fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign), "--out", str(fake.campaign.parent))
    assert done.returncode == 2
    assert_says(done.stderr, "folder", "no raw files")
