"""The QA stage names defects, and fails good campaigns at the stated rate only."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import MatrixDeformation, TargetMoved, TargetsSwapped
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, Targets
from tests.blind.generator.schedule import published_moves, random_moves
from tests.stages.line import run_line
from truing.report.quality_section import qa as qa_section
from truing.schemas.point_checks import OF_POINTS

PLAIN = Layout(name="plain", targets=Targets(per_leg=0))
K = 0.01 * np.random.default_rng(0).standard_normal((6, 6))


def _folder(tmp_path, layout=PLAIN, effects=(), seed=1, moves=None):
    campaign = draw_campaign(layout, moves or published_moves(), list(effects), np.random.default_rng(seed))
    return write_campaign(campaign, tmp_path / f"campaign{seed}", seed)


def _qa(tmp_path, layout=PLAIN, effects=(), seed=1, moves=None, extra=""):
    folder = _folder(tmp_path, layout, effects, seed, moves)
    if extra:
        with (folder / "campaign.toml").open("a", encoding="utf-8") as file:
            file.write(extra)
    tables, said = run_line(folder, "ingest", "qa")
    return tables["qa"].to_pandas(), said["qa"]


def _rows(qa, check):
    return qa[qa["check"] == check].set_index("subject")


def test_good_campaigns_do_not_fail(tmp_path):
    layouts = [
        PLAIN,
        replace(PLAIN, faults=DataFaults(missing_share=0.05, gross_share=0.03)),
        replace(PLAIN, noise=Noise(point_mm=0.0055, declared_point_mm=0.0071, axis_ratio=(1.0, 1.0, 2.0))),
        replace(PLAIN, noise=Noise(heavy_tails=True), surroundings=Surroundings(shuffled=True)),
    ]
    failed = []
    for seed, layout in enumerate(layouts * 2):
        effects = [MatrixDeformation(K)] if seed % 2 else []
        failed += _qa(tmp_path, layout, effects, seed)[1].failed_checks
    assert not failed  # one failure in a hundred campaigns is stated; the seeds are fixed


def test_every_check_says_what_it_found(tmp_path):
    qa, said = _qa(tmp_path)
    assert set(qa["check"]) <= set(OF_POINTS)
    assert set(qa["verdict"]) <= {"pass", "warn", "fail", "not evaluated"}
    assert qa["message"].str.len().min() > 10
    assert f"{len(qa)} checks" in said.figure
    judged = qa[qa["verdict"] != "not evaluated"]
    assert judged["value"].notna().all()
    assert judged["limit"].notna().all()


def test_exchanged_labels_fail_by_name(tmp_path):
    qa, said = _qa(tmp_path, effects=[TargetsSwapped("platform", ("P02", "P05"), (3, 4, 9))])
    rows = _rows(qa, "exchanged-labels")
    assert rows.loc["targets P02 P05", "verdict"] == "fail"
    assert rows.loc["targets P02 P05", "value"] == 3
    assert said.failed_checks == ("exchanged-labels targets P02 P05",)


def test_a_wrong_leg_in_the_survey_fails_by_name(tmp_path):
    folder = _folder(tmp_path)
    lines = (folder / "targets.csv").read_text(encoding="utf-8").splitlines()
    at_leg_2 = next(i for i, line in enumerate(lines) if line.endswith(",2"))
    lines[at_leg_2] = lines[at_leg_2][:-1] + "1"
    (folder / "targets.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    name = lines[at_leg_2].split(",")[1]
    said = run_line(folder, "ingest", "qa")[1]["qa"]
    assert said.failed_checks == (f"attachment-labels target {name}",)


def test_a_pose_without_points_is_reported(tmp_path):
    folder = _folder(tmp_path)
    points = (folder / "points.csv").read_text(encoding="utf-8").splitlines()
    kept = [line for line in points if not line.startswith("7,")]
    (folder / "points.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    qa = run_line(folder, "ingest", "qa")[0]["qa"].to_pandas()
    row = qa[qa["check"] == "unobserved-poses"].iloc[0]
    assert row["verdict"] == "warn"
    assert "pose 7" in row["message"]


def test_a_moved_target_is_named_with_its_pose_and_size(tmp_path):
    qa, said = _qa(tmp_path, effects=[TargetMoved("platform", "P03", (0.05, -0.03, 0.0), 20)])
    rows = _rows(qa, "moved-targets")
    moved = rows[rows["verdict"] == "warn"]
    assert list(moved.index) == ["target P03"]
    assert moved["value"].iloc[0] == pytest.approx(0.0583, abs=0.01)
    assert "from pose 20 on" in moved["message"].iloc[0]
    assert not said.failed_checks


def test_noise_far_above_the_declared_fails_and_ten_per_cent_does_not(tmp_path):
    twice = replace(PLAIN, noise=Noise(point_mm=0.010, declared_point_mm=0.005))
    qa, _ = _qa(tmp_path, twice)
    assert (_rows(qa, "noise")["verdict"][["base", "platform"]] == "fail").all()
    assert _rows(qa, "noise")["value"].between(1.6, 2.2).all()  # what is left out as gross trims the tails
    tenth = replace(PLAIN, noise=Noise(point_mm=0.0055, declared_point_mm=0.005))
    assert not (_rows(_qa(tmp_path, tenth, seed=2)[0], "noise")["verdict"] == "fail").any()


def test_a_deforming_platform_is_no_noisy_one(tmp_path):
    follow = replace(PLAIN, targets=Targets(per_leg=0, follow=0.5))
    qa, said = _qa(tmp_path, follow, [MatrixDeformation(2 * K)])
    assert not said.failed_checks
    assert _rows(qa, "noise").loc["platform z", "value"] < 1.3


FIXED = replace(PLAIN, surroundings=Surroundings(frame_turn_rad=0.0, frame_shift_mm=0.0))


def test_a_base_that_stands_still_in_a_fixed_frame_is_not_reported_to_drift(tmp_path):
    qa, _ = _qa(tmp_path, FIXED)
    assert _rows(qa, "base-drift").loc["base", "verdict"] == "not evaluated"  # the frame may change by pose
    qa, _ = _qa(tmp_path, FIXED, seed=2, extra='\n[measurement]\nframe = "campaign"\n')
    assert _rows(qa, "base-drift").loc["base", "verdict"] == "pass"
    qa, _ = _qa(tmp_path, FIXED, seed=3, extra='\n[measurement]\nframe = "series"\n')
    assert _rows(qa, "base-drift").loc["base", "verdict"] == "not evaluated"  # taken as one frame per pose


def test_only_a_body_declared_at_rest_can_drift(tmp_path):
    rng = np.random.default_rng(0)
    shape = rng.uniform(-100.0, 100.0, (5, 3))
    lines = [
        f"{pose},mirror,T{k},{','.join(f'{x:.4f}' for x in shape[k] + 50.0 * pose + 0.003 * rng.standard_normal(3))}"
        for pose in range(12)
        for k in range(5)
    ]
    (tmp_path / "points.csv").write_text("\n".join(["pose,body,target,x_mm,y_mm,z_mm", *lines]) + "\n")
    plain = '[campaign]\nname = "m"\nkind = "photogrammetry"\n[noise]\npoint_mm = 0.003\n'
    for more, verdict in (("", "not evaluated"), ('[bodies]\nreference = "mirror"\n', "warn")):
        (tmp_path / "campaign.toml").write_text(plain + more)
        drift = run_line(tmp_path, "ingest", "qa")[0]["qa"].to_pandas().set_index("check").loc["base-drift"]
        assert drift["verdict"] == verdict
    assert drift["value"] == pytest.approx(np.sqrt(3.0) * 50.0 * 11, rel=0.5)


def test_a_base_that_moves_once_is_not_said_to_drift(tmp_path):
    """An instrument that was knocked, or set up again after a break."""
    folder = _folder(tmp_path, FIXED)
    head, *lines = (folder / "points.csv").read_text(encoding="utf-8").splitlines()
    moved = [_shifted(line, 0.002, lambda pose: 40 * (int(pose) >= 20)) if ",base," in line else line for line in lines]
    (folder / "points.csv").write_text("\n".join([head, *moved]) + "\n", encoding="utf-8")
    row = _rows(run_line(folder, "ingest", "qa")[0]["qa"].to_pandas(), "base-drift").loc["base"]
    assert row["verdict"] == "warn"
    assert "jumps" in row["message"]
    assert "from pose 20 on" in row["message"]


def test_a_base_that_walks_in_a_fixed_frame_is_reported_with_its_size(tmp_path):
    folder = _folder(tmp_path, FIXED)
    head, *lines = (folder / "points.csv").read_text(encoding="utf-8").splitlines()
    walked = [_shifted(line, 0.002) if ",base," in line else line for line in lines]
    (folder / "points.csv").write_text("\n".join([head, *walked]) + "\n", encoding="utf-8")
    row = _rows(run_line(folder, "ingest", "qa")[0]["qa"].to_pandas(), "base-drift").loc["base"]
    assert row["verdict"] == "warn"
    assert "drifts" in row["message"]
    # 45 steps of 2 um; a running median over five poses sees four steps less, and noise adds some
    assert row["value"] == pytest.approx(0.09, abs=0.02)


def _shifted(line, per_pose_mm, poses=int):
    pose, body, target, x, *rest = line.split(",")
    return ",".join([pose, body, target, f"{float(x) + per_pose_mm * poses(pose):.5f}", *rest])


def test_many_missing_targets_fail(tmp_path):
    qa, said = _qa(tmp_path, replace(PLAIN, faults=DataFaults(missing_share=0.4, gross_share=0.0)))
    assert (_rows(qa, "completeness")["verdict"] == "fail").all()
    assert "completeness base" in said.failed_checks


def test_overruled_points_are_counted_and_an_unknown_target_warns(tmp_path):
    by = 'by = "M. Keller"\nreason = "loose"\n'
    extra = f'\n[[exclude]]\nbody = "platform"\ntarget = "P02"\n{by}\n[[keep]]\npose = 4\ntarget = "P77"\n{by}'
    qa, said = _qa(tmp_path, extra=extra)
    rows = _rows(qa, "overruled")
    assert rows["verdict"].tolist() == ["pass", "warn"]
    points = pd.read_csv(tmp_path / "campaign1" / "points.csv")
    seen = int(((points["body"] == "platform") & (points["target"] == "P02")).sum())
    assert rows.loc["exclude 1", "message"] == f"Body platform, target P02: {seen} points excluded by M. Keller: loose."
    assert rows.loc["keep 1", "message"] == "Pose 4, target P77: no point has this name, so none was kept by M. Keller."
    assert not said.failed_checks


def test_a_person_accepts_a_verdict_by_name(tmp_path):
    extra = (
        '\n[[accept]]\ncheck = "exchanged-labels"\nsubject = "targets P02 P05"\nby = "M. Keller"\nreason = "known"\n'
    )
    qa, said = _qa(tmp_path, effects=[TargetsSwapped("platform", ("P02", "P05"), (3, 4, 9))], extra=extra)
    row = _rows(qa, "exchanged-labels").loc["targets P02 P05"]
    assert row["verdict"] == "fail"
    assert row["accepted"] == "M. Keller: known"
    lead = qa_section({"qa": qa}).lead
    open_ones = qa[qa["accepted"].isna()]["verdict"].value_counts()
    for verdict, word in (("fail", "failed"), ("warn", "warn")):
        assert f", {open_ones.get(verdict, 0)} {word}" in said.figure
        assert (f"{open_ones.get(verdict, 0)} {verdict}" in lead) == (verdict in open_ones)
    assert said.figure.endswith(", 1 accepted")
    assert lead.endswith(", 1 accepted.")
    assert len(said.failed_checks) == open_ones.get("fail", 0)
    assert not said.failed_checks


def test_a_campaigns_own_limits_are_held_and_reported(tmp_path):
    extra = """
[qa.limits.geometry-leverage]
warn = 0.0
fail = 0.0
[qa.limits.temperature-span]
warn = 1e-9
reason = "procedure 7.3"
[qa.limits.geometry-plane]
warn = 0.01
"""
    qa, said = _qa(tmp_path, extra=extra)
    leverage, (span,) = _rows(qa, "geometry-leverage"), _rows(qa, "temperature-span").to_dict("records")
    assert set(leverage["verdict"]) == {"fail"}
    assert len(leverage) == len(said.failed_checks)
    assert (leverage["limit"] == 0.0).all()
    own = "Limit set by the campaign: warns above 0 (by default above 0.9), fails above 0 (by default never)."
    assert leverage["message"].str.endswith(own).all()
    assert (span["verdict"], span["limit"]) == ("warn", 1e-9)
    assert span["message"].endswith("campaign: warns above 1e-09 K (by default above 2 K): procedure 7.3.")
    assert not _rows(qa, "geometry-plane")["message"].str.contains("campaign").any()  # it is the default


def test_repeats_are_assessed_where_there_are_any(tmp_path):
    rng = np.random.default_rng(5)
    moves = random_moves(12, 2, rng)
    qa, _ = _qa(tmp_path, moves=[*moves, *((100 + move[0], *move[1:]) for move in moves)])
    assert _rows(qa, "repeatability").loc["platform", "verdict"] in ("pass", "warn")
    single, _ = _qa(tmp_path, moves=moves, seed=9)
    assert _rows(single, "repeatability")["verdict"].iloc[0] == "not evaluated"


def test_a_single_pose_without_a_survey_fails_no_check(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = [f"1,frame,t{k},{x:.4f},{y:.4f},{z:.4f}" for k, (x, y, z) in enumerate(rng.uniform(0.0, 500.0, (9, 3)))]
    (tmp_path / "points.csv").write_text("\n".join(["pose,body,target,x_mm,y_mm,z_mm", *rows]) + "\n")
    text = '[campaign]\nname = "one"\nkind = "photogrammetry"\n[noise]\npoint_mm = 0.01\n'
    (tmp_path / "campaign.toml").write_text(text)
    checks = run_line(tmp_path, "ingest", "qa")[0]["qa"].to_pylist()
    assert [row["check"] for row in checks if row["verdict"] == "fail"] == []
    assert [row["verdict"] for row in checks if row["check"] == "noise"] == ["not evaluated"]


@pytest.mark.parametrize(("poses", "targets"), [(12, 1), (12, 2), (1, 6), (1, 2)])
def test_checks_with_too_few_targets_or_one_pose_are_not_evaluated(tmp_path, poses, targets):
    rng = np.random.default_rng(1)
    shape = rng.uniform(-100.0, 100.0, (targets, 3))
    lines = [
        f"{pose},mirror,T{k},{','.join(f'{x:.4f}' for x in shape[k] + pose + 0.003 * rng.standard_normal(3))}"
        for pose in range(poses)
        for k in range(targets)
    ]
    (tmp_path / "points.csv").write_text("\n".join(["pose,body,target,x_mm,y_mm,z_mm", *lines]) + "\n")
    toml = '[campaign]\nname = "m"\nkind = "photogrammetry"\n[noise]\npoint_mm = 0.003\n'
    (tmp_path / "campaign.toml").write_text(toml)
    found = run_line(tmp_path, "ingest", "qa")[0]["qa"].to_pandas().set_index("check")["verdict"]
    unknown = ["gross-errors", "exchanged-labels", "moved-targets", "time-gaps"]
    assert (found[unknown] == "not evaluated").all()
    assert found["copied-poses"] == ("not evaluated" if poses == 1 else "pass")
