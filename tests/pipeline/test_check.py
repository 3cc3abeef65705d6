"""`truing check` finds faults before a run, and reports which stages the tables allow."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.broken.good import CAMPAIGNS
from tests.faults import assert_fault, faults_of
from tests.sentences import assert_says
from truing.pipeline.campaign_check import check_campaign
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.command_line import app
from truing.pipeline.in_memory import as_read, stage_line
from truing.pipeline.problems import ExitCode
from truing.pipeline.stage_order import stage_module
from truing.schemas.faults import Fault

HEAD = '[campaign]\nname = "c"\nkind = "photogrammetry"\n'
TOML = f"{HEAD}[noise]\npoint_mm = 0.01\n"


def rows(body: str, targets: int = 6) -> list[str]:
    return [f"{body},T{t},{100 * t},{37 * t % 50},{t * t}\n" for t in range(1, targets + 1)]


def points(*poses: str, body: str = "A", targets: int = 6) -> str:
    lines = (f"{pose},{row}" for pose in poses for row in rows(body, targets))
    return "".join(["pose,body,target,x_mm,y_mm,z_mm\n", *lines])


def survey(*bodies: str) -> str:
    return "".join(["body,target,x_mm,y_mm,z_mm\n", *(row for body in bodies for row in rows(body))])


def written(folder: Path, **files: str) -> Path:
    folder.mkdir(exist_ok=True)
    for name, text in {"campaign": TOML, **files}.items():
        (folder / (f"{name}.toml" if name == "campaign" else f"{name}.csv")).write_text(text)
    return folder


def faults(folder: Path) -> tuple[Fault, ...]:
    return faults_of(lambda: check_campaign(open_campaign(folder)))


def test_each_stage_says_what_it_will_evaluate(tmp_path: Path) -> None:
    checked = check_campaign(open_campaign(CAMPAIGNS["telescope"](tmp_path / "c")))
    assert [line.split(maxsplit=1) for line in checked.prospects] == [
        ["pose", "evaluated: base in 9 of 9 poses, platform in 9 of 9 poses"],
        ["deformation", "evaluated"],
        ["diagnose", "evaluated"],
        ["calibrate", "evaluated"],
    ]
    assert checked.attention == ()


def test_the_prospects_are_what_the_run_then_says(tmp_path: Path) -> None:
    folder = written(tmp_path, points=points("1", "2", "3", "4"), targets=survey("A"))
    expected = check_campaign(open_campaign(folder)).prospects
    done = CliRunner().invoke(app, ["run", str(folder), "--out", str(tmp_path / "run")])
    assert done.exit_code == ExitCode.DONE, done.output
    output = {line.split()[0]: line for line in done.output.splitlines() if line.strip()}
    for line in expected:
        stage, _, why = line.partition(" ")
        assert ("not evaluated" in output[stage]) == ("not evaluated" in why)
        if "not evaluated" in why:
            assert why.strip() in output[stage]


def test_a_reference_of_two_targets_is_why_nothing_is_diagnosed_in_check_and_run_alike(tmp_path: Path) -> None:
    poses = ("1", "2", "3", "4")
    shown = points(*poses) + "".join(points(*poses, body="R", targets=2).splitlines(keepends=True)[1:])
    folder = written(tmp_path / "c", campaign=TOML + '[bodies]\nreference = "R"\n', points=shown)
    why = "the reference body R shows at most 2 targets in a pose, so other bodies have no pose relative to it"
    reported = [line for line in check_campaign(open_campaign(folder)).prospects if line.startswith("diagnose")]
    assert reported == [f"diagnose     not evaluated: {why}"]
    done = CliRunner().invoke(app, ["run", str(folder), "--out", str(tmp_path / "run")])
    assert why in done.output


LOADS = "run,step,time_s,load_axis,load,channel,reading,unit\n"
SIGNALS = "run,step,time_s,fz_n,v1_mv\n"


@pytest.mark.parametrize(
    ("table", "text", "why"),
    [
        ("signals", SIGNALS + "".join(f"a,{i},{i},10,{i % 3}\n" for i in range(1, 9)), "needs loads that change"),
        ("signals", SIGNALS + "".join(f"a,{i},{i},{i},{i}\n" for i in range(1, 4)), "needs at least 6 load steps"),
        (
            "interferometer",
            LOADS + "".join(f"a,{i},{i},fz,{i},dz,{i},um\n" for i in range(1, 9)),
            "needs a [mechanism] whose compliance can be simulated",
        ),
    ],
)
def test_a_bench_that_cannot_be_diagnosed_is_reported(tmp_path: Path, table: str, text: str, why: str) -> None:
    head = '[campaign]\nname = "b"\nkind = "interferometer"\n[noise]\nlinear_um = 0.5\nsignal_mv = 0.1\n'
    prospects = check_campaign(open_campaign(written(tmp_path, campaign=head, **{table: text}))).prospects
    (line,) = [line for line in prospects if line.startswith("diagnose")]
    assert f"not evaluated: {why}" in line


def test_a_bench_without_declared_noise_is_reported_as_not_diagnosable(tmp_path: Path) -> None:
    folder = CAMPAIGNS["bench"](tmp_path / "c")
    text = (folder / "campaign.toml").read_text()
    for key in ("linear_um", "angular_arcsec"):
        text = text.replace(key, f"# {key}")
    (folder / "campaign.toml").write_text(text)
    checked = check_campaign(open_campaign(folder))
    (line,) = [line for line in checked.prospects if line.startswith("diagnose")]
    assert "not evaluated: needs the noise of dx, dy, dz, rx, ry, rz: noise.linear_um, noise.angular_arcsec" in line


def test_a_campaign_of_which_nothing_can_be_evaluated_is_not_reported_to_have_no_fault(tmp_path: Path) -> None:
    checked = check_campaign(open_campaign(written(tmp_path, points=points("1", "2", "3", targets=2))))
    assert not checked.is_evaluated
    assert all("not evaluated: no body shows 3 targets in one pose" in line for line in checked.prospects)
    done = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert (done.exit_code, "no fault" in done.output) == (ExitCode.DONE, False)
    assert_says(done.output, "campaign.toml", "only the quality", "6 points")


def test_points_of_no_surveyed_body_are_a_fault(tmp_path: Path) -> None:
    (fault,) = faults(
        written(tmp_path, points=points("1", "2", "3", body="platte"), targets=survey("base", "platform"))
    )
    assert fault.value == "platte"
    assert_says(fault.expected, "surveyed (base, platform)")


def test_a_survey_without_a_standard_deviation_is_a_fault_and_no_defect(tmp_path: Path) -> None:
    text = points("1", "2", "3").replace("z_mm\n", "z_mm,sigma_x_mm,sigma_y_mm,sigma_z_mm\n")
    head, *lines = text.splitlines()
    known = "\n".join([head, *(f"{line},0.01,0.01,0.01" for line in lines)]) + "\n"
    (fault,) = faults(written(tmp_path, campaign=HEAD, points=known, targets=survey("A")))
    assert (fault.column, fault.value) == ("noise.point_mm", None)
    assert_says(fault.expected, "surveyed targets", "targets.csv")


@pytest.mark.parametrize("kind", ["photogrammetry", "interferometer"])
def test_the_template_of_an_empty_folder_asks_for_a_table(tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "empty"
    folder.mkdir()
    assert CliRunner().invoke(app, ["init", str(folder)]).exit_code == ExitCode.DONE
    text = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(text.replace('kind = "photogrammetry"', f'kind = "{kind}"'))
    assert any(fault.expected.startswith("this file") for fault in faults(folder))


def test_a_drive_without_any_configurations_is_a_fault(tmp_path: Path) -> None:
    toml = TOML.replace('kind = "photogrammetry"', 'kind = "photogrammetry"\ndrives = ["elevation_deg"]')
    folder = written(tmp_path, campaign=toml, points=points("1", "2", "3"))
    assert_fault(faults(folder), file="campaign.toml", column="campaign.drives", value="elevation_deg")


def test_the_template_of_points_asks_for_the_noise(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(points("1", "2", "3"))
    (tmp_path / "targets.csv").write_text(survey("A"))
    assert CliRunner().invoke(app, ["init", str(tmp_path)]).exit_code == ExitCode.DONE
    assert "noise.point_mm" in {fault.column for fault in faults(tmp_path)}


CONFIGURED = "pose,role,time_s,rho1_mm,rho2_mm\n1,calibration,1,0,0\n2,calibration,2,1,1\n3,calibration,3,2,1\n"


@pytest.mark.parametrize(
    ("files", "stated"),
    [
        (
            {"points": points("1", "2", "3"), "configurations": f"{CONFIGURED}4,calibration,4,1,1\n"},
            "no point was measured in pose 4 of configurations",
        ),
        ({"points": points("1", "2", "3"), "targets": survey("A", "B")}, "no point was measured of surveyed body B"),
        (
            {"points": points("1", "2", "3") + points("1", body="C").split("\n", 1)[1], "targets": survey("A")},
            "no survey has body C",
        ),
        (
            {"points": points("1", "2", "3").replace("2,A,T2", "2,A,TZ"), "targets": survey("A")},
            "target TZ of body A in pose 2, where T2 is missing; did you mean T2?",
        ),
        (
            {"points": points("1", "2", "3").replace("2,A,T2", "2,A,2T")},
            "target 2T of body A in pose 2, where T2 is missing; did you mean T2?",
        ),
        (
            {"points": points("1", "2", "3").replace("A,T2", "A,front left"), "targets": survey("A")},
            "target front left of body A in poses 1, 2, 3, where T2 is missing; did you mean T2?",
        ),
        ({"points": points("1", "2", "3"), "configurations": CONFIGURED}, "no [mechanism] says of which machine"),
        ({"points": points("P1", "p1", "P 2", "P2", "P3")}, "poses P1 and p1 are treated as different"),
        ({"points": points("P1", "P01", "P2", "P3")}, "poses P1 and P01 are treated as different; did you mean one?"),
        (
            {"points": points("1", "2", "3", body="plate"), "targets": survey("Plate", "plate")},
            "bodies Plate and plate are treated as different; did you mean one?",
        ),
        (
            {"points": points("1", "2", "3"), "targets": survey("A").replace("T1", "t01")},
            "targets of body A t01 and T1 are treated as different; did you mean one?",
        ),
        (
            {
                "points": points("1", "2", "3"),
                "configurations": "pose,role\n1,reference\n2,verification\n3,verification\n",
            },
            "no pose has the role calibration; found only reference, verification",
        ),
        (
            {"points": points("1", "2", "3"), "configurations": "pose,temprature_c\n1,20\n2,21\n3,22\n"},
            "column temprature_c of configurations is a quantity of your own; did you mean temperature_c?",
        ),
    ],
)
def test_a_probable_mistake_is_named_under_attention(tmp_path: Path, files: dict[str, str], stated: str) -> None:
    folder = written(tmp_path, **files)
    assert any(stated in sentence for sentence in check_campaign(open_campaign(folder)).attention)
    done = CliRunner().invoke(app, ["check", str(folder)])
    assert (done.exit_code, f"attention: {stated}" in done.output or stated in done.output) == (ExitCode.DONE, True)


def test_a_frame_per_series_is_reported_to_be_taken_as_one_per_pose(tmp_path: Path) -> None:
    output = {}
    for frame in ("pose", "series", "campaign"):
        toml = f'{TOML}[measurement]\nframe = "{frame}"\n'
        folder = written(tmp_path / frame, campaign=toml, points=points("1", "2", "3"))
        output[frame] = check_campaign(open_campaign(folder)).attention
    assert output["pose"] == output["campaign"] == ()
    (sentence,) = output["series"]
    assert 'treated like "pose"' in sentence


def test_a_frame_per_series_of_an_arm_is_not_said_to_be_ignored(tmp_path: Path) -> None:
    arm = '[mechanism]\ntype = "chain"\njoints = ["j"]\nscrews = [{ axis = [0, 0, 1] }]\n'
    numbered = "".join(f"{k},{10 * k},a\n" for k in range(1, 13))
    tip = "".join(f"{k},tip,T,{k}.5,{k * k},{7 * k % 5}\n" for k in range(1, 13))
    folder = written(
        tmp_path / "arm",
        campaign=f'{TOML}{arm}[measurement]\nframe = "series"\n',
        points=f"pose,body,target,x_mm,y_mm,z_mm\n{tip}",
        configurations=f"pose,j_deg,series\n{numbered}",
    )
    assert not any("series" in sentence for sentence in check_campaign(open_campaign(folder)).attention)


@pytest.mark.parametrize(
    ("files", "stated"),
    [
        ({"points": points("1", "2", body="platte"), "targets": survey("Platte")}, "did you mean Platte by platte?"),
        (
            {"points": points("p1", "p2", "p3"), "configurations": CONFIGURED.replace("\n", "\nP0").removesuffix("P0")},
            "a pose of configurations; did you mean P01 by p1?",
        ),
        (
            {"points": points("1", "2"), "targets": survey("A").replace("T", "t0")},
            "names they have in the survey (t01, t02, t03, ...); did you mean t01 by T1?",
        ),
    ],
)
def test_names_that_another_table_spells_otherwise_are_hinted_at(
    tmp_path: Path, files: dict[str, str], stated: str
) -> None:
    assert any(stated in fault.expected for fault in faults(written(tmp_path, **files)))


def test_runs_that_two_tables_spell_otherwise_are_reported(tmp_path: Path) -> None:
    head = '[campaign]\nname = "b"\nkind = "interferometer"\n[noise]\nlinear_um = 0.5\nsignal_mv = 0.1\n'
    readings = LOADS + "".join(f"R01,{i},{i},fz,{i},dz,{i},um\n" for i in range(1, 9))
    signals = SIGNALS + "".join(f"r1,{i},{i},{i},{i}\n" for i in range(1, 9))
    folder = written(tmp_path, campaign=head, interferometer=readings, signals=signals)
    output = check_campaign(open_campaign(folder)).attention
    assert_says(output, "runs R01 and r1", "different")


def test_poses_that_are_counted_are_no_names_that_look_alike(tmp_path: Path) -> None:
    folder = written(tmp_path, points=points(*(str(n) for n in (1, 2, 3, 10, 11, 100, 101))))
    assert check_campaign(open_campaign(folder)).attention == ()


def test_images_that_are_no_photographs_are_named(tmp_path: Path) -> None:
    (tmp_path / "images" / "1").mkdir(parents=True)
    (tmp_path / "images" / "1" / "a.heic").write_bytes(b"picture")
    fault = assert_fault(faults(written(tmp_path)), file="images/1/a.heic")
    assert_says(fault.expected, "photograph as JPEG")


def test_a_faulty_survey_is_reported_before_photographs_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from PIL import Image

    import truing.stages.images

    (tmp_path / "images" / "1").mkdir(parents=True)
    Image.new("L", (120, 160), 128).save(tmp_path / "images" / "1" / "a.png")
    folder = written(tmp_path, targets=survey("A").replace("100,37", "100,abc"))
    monkeypatch.setattr(truing.stages.images, "run", lambda *_: pytest.fail("photographs were measured first"))
    done = CliRunner().invoke(app, ["run", str(folder), "--out", str(tmp_path / "run")])
    assert done.exit_code == ExitCode.UNUSABLE_CAMPAIGN
    assert_says(done.output, "targets.csv", "row 2", "column y_mm")
    assert "'abc'" in done.output


def test_a_survey_without_noise_is_reported_before_photographs_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from PIL import Image

    import truing.stages.images

    (tmp_path / "images" / "1").mkdir(parents=True)
    Image.new("L", (120, 160), 128).save(tmp_path / "images" / "1" / "a.png")
    folder = written(tmp_path, campaign=HEAD, targets=survey("A"))
    monkeypatch.setattr(truing.stages.images, "run", lambda *_: pytest.fail("photographs were measured first"))
    done = CliRunner().invoke(app, ["run", str(folder), "--out", str(tmp_path / "run")])
    assert (done.exit_code, "noise.point_mm" in done.output) == (ExitCode.UNUSABLE_CAMPAIGN, True)


def rays(target: str) -> str:
    """Rays of one image to six targets of base; the point that a survey would know begins with this name."""
    lines = [f"1,a,base,{target}{n},{100 + 50 * n},{100 + 37 * n % 90}\n" for n in range(1, 7)]
    return "".join(["pose,image,body,target,x_px,y_px\n", *lines])


CAMERA = '[[cameras]]\nname = "camera"\nwidth_px = 640\nheight_px = 480\nfocal_px = 700.0\n'
RAYS = {
    "campaign": f"{TOML}image_px = 0.05\n{CAMERA}",
    "targets": survey("base"),
}


@pytest.mark.parametrize("command", ["check", "run"])
def test_rays_to_targets_that_no_survey_knows_are_a_fault(
    tmp_path: Path, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import truing.stages.bundle

    monkeypatch.setattr(truing.stages.bundle, "run", lambda *_: pytest.fail("the rays were adjusted first"))
    folder = written(tmp_path / "c", **RAYS, image_points=rays("Q"))
    to = ["--out", str(tmp_path / "run")] if command == "run" else []
    done = CliRunner().invoke(app, [command, str(folder), *to])
    assert done.exit_code == ExitCode.UNUSABLE_CAMPAIGN, done.output
    assert_says(done.output, "base/Q1, base/Q2, base/Q3", "rays to targets", "survey", "T1, T2, T3")


@pytest.mark.parametrize("points", [rays("T"), rays("Q").replace(",Q3,", ",,")])
def test_rays_that_the_survey_knows_or_may_name_are_none(tmp_path: Path, points: str) -> None:
    folder = written(tmp_path, **RAYS, image_points=points)
    checked = check_campaign(open_campaign(folder))
    assert_says(checked.prospects[0], "photographs", "adjusted")


def test_a_standard_deviation_that_many_files_lack_is_reported_once(tmp_path: Path) -> None:
    for number in range(12):
        (tmp_path / f"export_{number}.csv").write_text("target,x_mm,y_mm,z_mm\nA,1,2,3\nB,4,5,6\n")
    (tmp_path / "campaign.toml").write_text(
        '[campaign]\nname = "c"\nkind = "photogrammetry"\n[files.points]\npath = "export_*.csv"\n'
        "from_name = 'export_(?P<pose>\\d+)'\nconstants = { body = \"b\" }\n"
    )
    (fault,) = faults(tmp_path)
    assert (fault.file, fault.column) == ("campaign.toml", "noise.point_mm")
    assert "export_0.csv" in fault.expected
    assert_says(fault.expected, "11 other files")


def test_a_survey_without_a_standard_deviation_is_reported_next_to_faults_of_other_tables(tmp_path: Path) -> None:
    found = faults(
        written(tmp_path, campaign=HEAD, points=points("1", "x"), configurations="pose\n1\n1\n", targets=survey("A"))
    )
    assert any("of surveyed targets" in fault.expected for fault in found if fault.column == "noise.point_mm")
    assert "configurations.csv" in {fault.file for fault in found}


def test_readings_that_depart_from_poses_are_reported(tmp_path: Path) -> None:
    folder = CAMPAIGNS["telescope"](tmp_path / "c")
    head, *lines = (folder / "configurations.csv").read_text().splitlines()
    names, table = head.split(","), [line.split(",") for line in lines]
    for n, row in enumerate(table):
        for leg in range(6):
            place = names.index(f"rho{leg + 1}_mm")
            row[place] = str(float(row[place]) + 0.3 * (-1) ** ((5 * n + 3 * leg + n * leg) // 2))
    (folder / "configurations.csv").write_text("\n".join([head, *map(",".join, table)]) + "\n")
    done = CliRunner().invoke(app, ["check", str(folder)])
    assert done.exit_code == ExitCode.DONE, done.output
    assert_says(done.output, "attention", "Actuator readings", "measured poses")


@pytest.mark.parametrize("subject", ["telescope", "bench"])
def test_files_are_read_once_and_the_quality_checks_see_what_a_run_sees(
    subject: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = CAMPAIGNS[subject](tmp_path / "c")
    again = stage_line(folder).call("ingest").tables
    kept = check_campaign(open_campaign(folder)).ingested
    assert kept is not None
    assert {name: as_read(table) for name, table in kept.items()} == again
    ingest, calls = stage_module("ingest"), []
    original = ingest.run
    monkeypatch.setattr(ingest, "run", lambda *given: calls.append(given) or original(*given))
    assert CliRunner().invoke(app, ["check", str(folder)]).exit_code == ExitCode.DONE
    assert len(calls) == 1


@pytest.mark.parametrize(
    "measured",
    [
        pytest.param(points("1", "2", "3").replace("A,T2", "A,left").replace("A,T3", "A,right"), id="two in two"),
        pytest.param(points("1", "2", "3") + "1,A,left,1,2,3\n2,A,left,1,2,3\n", id="one more than the survey"),
    ],
)
def test_a_target_that_may_be_several_or_none_is_not_asked_about(tmp_path: Path, measured: str) -> None:
    campaign = open_campaign(written(tmp_path, points=measured, targets=survey("A")))
    assert not any("is missing; did you mean" in reported for reported in check_campaign(campaign).attention)
