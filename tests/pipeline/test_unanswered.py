"""`truing check` names open keys and guesses of a starter until a person has answered them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.changed_files import replace_text
from tests.sentences import assert_says
from truing.pipeline.campaign_check import CampaignCheck, check_campaign
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.campaign_run import PROJECT
from truing.pipeline.campaign_template import MARK
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode

BENCH = PROJECT / "sample_data" / "force-sensor"
LOADS = "t,x_displacement,y_displacement,x_force,y_force,z_force\n" + "".join(f"{k},{k},1,{k},0,0\n" for k in range(9))
CHANNELS = "Fx,Fy,Fz,s0,s1,s2\n" + "".join(f"{k},0,0,{k},{-k},1\n" for k in range(9))
PHASES = "Phase (deg),Radius\n" + "".join(f"{30.0 * k % 360:.1f},{500.0 + k % 3}\n" for k in range(40))
SIDE_BY_SIDE = "Frame,A_x,A_y,A_z,B_x,B_y,B_z,C_x,C_y,C_z\n" + "".join(f"{k},1,2,3,4,5,6,7,8,10\n" for k in range(4))
UNITS = "no unit is given; assumed are "


def started(folder: Path, **files: str) -> str:
    """The starter of a folder with these files."""
    for name, text in files.items():
        (folder / f"{name}.csv").write_text(text)
    assert CliRunner().invoke(app, ["init", str(folder)]).exit_code == ExitCode.DONE
    return (folder / "campaign.toml").read_text(encoding="utf-8")


def answered(folder: Path, *changes: tuple[str, str]) -> CampaignCheck:
    for before, after in changes:
        replace_text(folder / "campaign.toml", before, after)
    return check_campaign(open_campaign(folder))


def test_noise_of_a_bench_that_nobody_declared_is_named_with_its_keys(tmp_path: Path) -> None:
    for name in ("interferometer.csv", "signals.csv"):
        shutil.copy(BENCH / name, tmp_path)
    text = started(tmp_path)
    needed = [line.split()[1] for line in text.splitlines() if "needed" in line and line.startswith("# ")][1:]
    assert needed == ["linear_um", "angular_arcsec", "signal_mv"]
    (sentence,) = check_campaign(open_campaign(tmp_path)).attention
    assert all(f"noise.{key}" in sentence for key in needed)
    assert "nothing is diagnosed" in sentence
    (sentence,) = answered(tmp_path, ("# linear_um", "linear_um"), ("# angular", "angular")).attention
    assert "noise.signal_mv" in sentence
    assert "linear_um" not in sentence
    assert_says(sentence, "signals", "left out", "diagnosis")
    assert answered(tmp_path, ("# signal_mv", "signal_mv")).attention == ()


@pytest.mark.parametrize(
    ("text", "marked", "keys"),
    [
        (LOADS, (UNITS + "s for t, mm for x_displacement", 'run = "1"'), ("noise.displacement_mm",)),
        (CHANNELS, ("mV for s0 s1 s2", "N for Fx Fy Fz", 'run = "1"'), ("noise.signal_mv",)),
        (PHASES, ('channel = "dz" is a guess', "without a load"), ()),
        (SIDE_BY_SIDE, ('body = "body" is a guess', "coordinates are assumed to be in mm"), ()),
    ],
)
def test_guesses_are_marked_and_reported_until_the_remark_is_gone(
    tmp_path: Path, text: str, marked: tuple[str, ...], keys: tuple[str, ...]
) -> None:
    starter = started(tmp_path, log=text)
    (line,) = [line for line in starter.splitlines() if line.startswith(MARK)]
    assert all(words in line for words in marked)
    place = starter.splitlines().index(line) + 1
    reported = answered(tmp_path, *[("# point_mm", "point_mm")] * ("# point_mm" in starter)).attention
    assert_says(reported, f"line {place}", "campaign.toml", "guess")
    assert all(any(key in one for one in reported) for key in keys)
    assert not any("guess" in one for one in answered(tmp_path, (line, "")).attention)


def test_noise_that_the_signals_of_an_interferometer_show_themselves_is_not_asked_for(tmp_path: Path) -> None:
    assert "needed" not in started(tmp_path, log=PHASES).split("[", 1)[1]
    assert not any("standard deviation" in one for one in answered(tmp_path).attention)


def test_columns_with_units_are_proposed_without_a_guess(tmp_path: Path) -> None:
    text = started(tmp_path, log="pose,body,target,X [mm],Y [mm],Z [mm]\n1,b,A,1.5,2.5,3.5\n1,b,B,4.5,5.5,6.5\n")
    assert "[files.points]" in text
    assert MARK not in text


def test_photographs_without_a_scale_are_reported_with_the_remedy(tmp_path: Path) -> None:
    shot = next((PROJECT / "sample_data" / "telescope-images" / "images").rglob("*.jpg"))
    (tmp_path / "images" / "1").mkdir(parents=True)
    shutil.copy(shot, tmp_path / "images" / "1")
    started(tmp_path)
    (sentence,) = check_campaign(open_campaign(tmp_path)).attention
    assert_says(sentence, "photographs", "no scale")
    assert "scale_bars.csv" in sentence
    (tmp_path / "scale_bars.csv").write_text("bar,first,second,length_mm,sigma_mm\nB,p,q,500,0.01\n")
    assert check_campaign(open_campaign(tmp_path)).attention == ()


def test_positioning_runs_as_the_contract_has_them_need_no_entry(tmp_path: Path) -> None:
    ways = ("forward", "backward")
    rows = "".join(f"1,{10 * at},{way},{cycle},{10 * at}.001\n" for cycle in (1, 2) for at in range(4) for way in ways)
    started(tmp_path, positioning="run,target_mm,direction,cycle,position_mm\n" + rows)
    checked = check_campaign(open_campaign(tmp_path))
    assert_says(checked.read, "16 approaches", "axis")
    assert checked.attention == ()


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        ('body = "base"\ntarget = "P11"', ("exclude.1", "P11", "did you mean P1?")),
        ('body = "bsae"', ("exclude.1", "bsae", "did you mean base?")),
        ('body = "base"\ntarget = "P1"', ()),
    ],
)
def test_a_decision_on_a_body_or_target_that_nobody_measured_is_named(
    tmp_path: Path, rule: str, expected: tuple[str, ...]
) -> None:
    rows = "".join(f"{pose},base,P{k},{k},{k * k},{k + pose}\n" for pose in (1, 2) for k in (1, 2, 3))
    (tmp_path / "points.csv").write_text(f"pose,body,target,x_mm,y_mm,z_mm\n{rows}")
    decision = f'[[exclude]]\n{rule}\nby = "Ann"\nreason = "moved"\n'
    head = '[campaign]\nname = "c"\nkind = "photogrammetry"\n[noise]\npoint_mm = 0.01\n'
    (tmp_path / "campaign.toml").write_text(head + decision)
    named = [one for one in check_campaign(open_campaign(tmp_path)).attention if one.startswith("exclude")]
    assert len(named) == bool(expected)
    assert all(words in named[0] for words in expected)


def test_joint_readings_without_an_arm_are_named(tmp_path: Path) -> None:
    rows = "".join(f"{pose},base,P{k},{k},{k * k},{k + pose}\n" for pose in (1, 2) for k in (1, 2, 3))
    (tmp_path / "points.csv").write_text(f"pose,body,target,x_mm,y_mm,z_mm\n{rows}")
    (tmp_path / "configurations.csv").write_text("pose,joint1_deg,joint2_deg\n1,10,20\n2,30,40\n")
    head = '[campaign]\nname = "c"\nkind = "photogrammetry"\n[noise]\npoint_mm = 0.01\n'
    (tmp_path / "campaign.toml").write_text(head)
    (reported,) = (one for one in check_campaign(open_campaign(tmp_path)).attention if "joint" in one)
    assert_says(reported, "joint1_deg", "joint2_deg", "chain")
