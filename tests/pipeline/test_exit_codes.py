"""End of a run: exit codes and messages."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.pipeline.fake_project import STAGES, FakeProject
from tests.sentences import assert_says
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode
from truing.schemas.faults import Fault


def lines(text: str) -> list[str]:
    return text.splitlines()


def test_a_clean_run_exits_with_0(fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign))
    assert (done.returncode, done.stderr) == (0, "")
    assert lines(done.stdout)[-2:] == [f"report: {Path('runs') / 'bench' / 'report.html'}", "exit code 0: done"]
    closing = lines(done.stdout)[0].split("; ")
    assert closing[:3] == ["ingest       1/8: read 3 points", "left out nothing", "no fault"]
    assert closing[-1].endswith(" s")


def test_a_failed_check_is_3_until_it_is_only_a_warning(ran: FakeProject) -> None:
    ran.edit(ran.campaign / "points.csv", "4.0", "4000.0")
    ran.run(expect=3)
    done = ran.call("run", str(ran.campaign))
    assert done.returncode == 3, "nothing to do, but the check still fails"
    assert done.stderr == "QA: 1 failed (size); the report says why\n"
    assert ran.run("--qa=warn") == []
    shutil.rmtree(ran.out / ".truing")
    ran.run(expect=3)


def test_faults_of_the_raw_files_are_2_and_leave_nothing(fake: FakeProject) -> None:
    fake.edit(fake.campaign / "points.csv", "4.0", "nan")
    done = fake.call("run", str(fake.campaign))
    assert done.returncode == 2
    assert lines(done.stderr) == [str(Fault("points.csv", "a finite number", row=3, column="x_mm", value="nan"))]
    assert list(fake.cwd.iterdir()) == []


def test_faults_leave_an_earlier_run_as_it_was(ran: FakeProject) -> None:
    before = {path: path.read_bytes() for path in ran.out.rglob("*") if path.is_file() and path.name != "lock"}
    ran.edit(ran.campaign / "points.csv", "4.0", "nan")
    ran.run(expect=2)
    assert {path: path.read_bytes() for path in ran.out.rglob("*") if path.is_file() and path.name != "lock"} == before


def test_all_faults_at_once_those_of_campaign_toml_and_of_the_raw_files(fake: FakeProject) -> None:
    fake.edit(fake.campaign / "points.csv", "4.0", "nan")
    fake.edit(fake.campaign / "campaign.toml", "point_mm = 0.005", "pont_mm = 0.005\nactuator_mm = -1.0")
    for command in ("run", "check"):
        done = fake.call(command, str(fake.campaign))
        assert done.returncode == 2
        assert len(lines(done.stderr)) == 3
        assert_says(done.stderr, "did you mean", "point_mm")
        assert "noise.actuator_mm: found '-1.0'" in done.stderr
        assert "points.csv, row 3" in done.stderr
        assert list(fake.cwd.iterdir()) == []


def test_an_invalid_name_hides_no_other_fault(fake: FakeProject) -> None:
    fake.edit(fake.campaign / "points.csv", "4.0", "nan")
    fake.edit(fake.campaign / "campaign.toml", '"bench"', '"a/b"')
    done = fake.call("run", str(fake.campaign))
    assert done.returncode == 2
    assert [line.split(",")[0].rpartition("/")[2] for line in lines(done.stderr)] == ["campaign.toml", "points.csv"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"bench"', '"../bench"', "campaign.name: found '../bench'; expected a name that can be a folder's"),
        ('"bench"', '"CON"', "campaign.name: found 'CON'"),
        ('name = "bench"\n', "", "campaign.name: expected"),
        ('"photogrammetry"', '"photogrametry"', "campaign.kind: found 'photogrametry'"),
        ("[noise]", "[noise", "row 6: expected valid TOML"),
    ],
)
def test_faults_of_campaign_toml(fake: FakeProject, old: str, new: str, words: str) -> None:
    fake.edit(fake.campaign / "campaign.toml", old, new)
    done = fake.call("run", str(fake.campaign))
    assert done.returncode == 2
    assert len(lines(done.stderr)) == 1
    assert words in done.stderr
    assert list(fake.cwd.iterdir()) == []


def test_no_campaign_there(fake: FakeProject) -> None:
    done = fake.call("run", "nowhere")
    assert done.returncode == 2
    assert "a campaign folder" in done.stderr


def test_a_stage_that_there_is_not(fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign), "--only", "posse")
    assert done.returncode == 2
    assert_says(done.stderr, "did you mean", "pose")


def test_a_defect_exits_with_1_and_writes_a_log(fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign), trouble="crash")
    assert done.returncode == 1
    assert len(lines(done.stderr)) == 1
    assert "stage pose" in done.stderr
    assert_says(done.stderr, "RuntimeError", "no such luck")
    assert_says((fake.out / "defect.log").read_text(), "RuntimeError", "no such luck")
    assert fake.run() == list(STAGES)[2:]
    assert not (fake.out / "defect.log").exists()


@pytest.mark.parametrize(("trouble", "words"), [("undeclared", "diagnosis"), ("schema", "columns dz_mm are missing")])
def test_a_stage_that_returns_undeclared_tables_is_a_defect(fake: FakeProject, trouble: str, words: str) -> None:
    done = fake.call("run", str(fake.campaign), trouble=trouble)
    assert done.returncode == 1
    assert words in done.stderr
    assert not (fake.out / "residuals.parquet").exists()


def test_the_worst_exit_code_of_several_campaigns_counts_and_all_are_tried(fake: FakeProject) -> None:
    done = fake.call("run", "nowhere", str(fake.campaign), "--out", "both")
    assert done.returncode == 2
    assert (fake.cwd / "both" / "bench" / "report.html").exists()


def test_two_campaigns_of_one_name_in_one_call(ran: FakeProject, tmp_path: Path) -> None:
    shutil.copytree(ran.campaign, tmp_path / "second")
    done = ran.call("run", str(ran.campaign), str(tmp_path / "second"))
    assert done.returncode == 2
    assert_says(done.stderr, "name", "no other campaign")


def test_a_run_never_writes_where_the_raw_files_are(fake: FakeProject) -> None:
    before = sorted(fake.campaign.iterdir())
    done = fake.call("run", str(fake.campaign), "--out", str(fake.campaign))
    assert done.returncode == 2
    assert_says(done.stderr, "no raw files")
    assert sorted(fake.campaign.iterdir()) == before


def test_check_says_that_a_campaign_can_be_used_and_writes_nothing(fake: FakeProject) -> None:
    done = fake.call("check", str(fake.campaign))
    assert (done.returncode, done.stderr) == (0, "")
    assert "no fault" in done.stdout
    assert "read 3 points" in done.stdout
    assert list(fake.cwd.iterdir()) == []


def test_quiet_says_nothing_when_nothing_went_wrong(fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign), "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("command", ["run", "check", "stages", "watch", "design", "power", "plan", "report", "export"])
def test_every_command_that_fails_ends_with_the_reason_of_its_exit_code(tmp_path: Path, command: str) -> None:
    words = [command, str(tmp_path / "none")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == ExitCode.UNUSABLE_CAMPAIGN
    assert lines(done.stdout)[-1] == f"exit code 2: {ExitCode.UNUSABLE_CAMPAIGN.meaning}"
    assert done.stderr
    assert CliRunner().invoke(app, [*words, "--quiet"]).stdout == ""


def test_rounds_of_json_are_json_alone(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["watch", str(tmp_path / "none"), "--json"])
    assert (done.exit_code, done.stdout) == (ExitCode.UNUSABLE_CAMPAIGN, "")
