"""An arm at three poses, one of which repeats far worse: reported pose by pose, single reflectors included."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.sentences import assert_says
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import exp_so3
from truing.pipeline.command_line import app
from truing.pipeline.in_memory import StageLine, stage_line
from truing.report.events_section import during
from truing.report.page import ReportSection

TOML = """
[campaign]
name = "arm"
kind = "photogrammetry"
[bodies]
reference = "base"
[noise]
point_mm = 0.005
"""
REPEATS, GROUPS = 10, 3
WORST = 2  # the group that repeats worse
BASE = np.array([[0.0, 0, 0], [900, 0, 0], [0, 800, 0], [300, 300, 500]])
TOOL = np.array([[0.0, 0, 0], [120, 0, 0], [0, 130, 0], [40, 40, 90]])
POSES = [(np.array([x, 200.0, 900.0]), np.array([0.3, 1.0 * k, 2.0 * k])) for k, x in enumerate((400.0, 900.0, 1500.0))]


def written(folder: Path, scatter_mm: tuple[float, ...], toml: str = TOML, bodies: tuple[str, ...] = ()) -> StageLine:
    """Three poses in turn, ten times; the arm comes back to each within its own scatter."""
    rng = np.random.default_rng(7)
    points, poses = ["pose,body,target,x_mm,y_mm,z_mm"], ["pose,role,time_s,repeat_of"]
    for number in range(REPEATS * GROUPS):
        k = number % GROUPS
        place = POSES[k][0] + rng.normal(0.0, scatter_mm[k], 3)
        tool = TOOL @ exp_so3(POSES[k][1] + rng.normal(0.0, 1e-5, 3)).T + place
        seen = {"base": BASE, "tool": tool, "ball": place[None] + [[0.0, 60.0, 0.0]]}
        for body, own in seen.items():
            if bodies and body not in bodies:
                continue
            for name, point in enumerate(own + rng.normal(0.0, 0.005, own.shape)):
                points.append(f"p{number},{body},{body}{name},{','.join(f'{x:.5f}' for x in point)}")
        poses.append(f"p{number},calibration,{60 * number},{f'p{k}' if number >= GROUPS else ''}")
    (folder / "points.csv").write_text("\n".join(points) + "\n")
    (folder / "configurations.csv").write_text("\n".join(poses) + "\n")
    (folder / "campaign.toml").write_text(toml)
    return stage_line(folder)


@pytest.fixture(scope="module")
def uneven(tmp_path_factory) -> StageLine:
    scatter = tuple(0.3 if k == WORST else 0.01 for k in range(GROUPS))
    return written(tmp_path_factory.mktemp("arm"), scatter).call("ingest", "qa", "pose", "calibrate")


def of_repeatability(line: StageLine) -> dict[str, dict]:
    return {row["subject"]: row for row in line.tables["qa"].to_pylist() if row["check"] == "repeatability"}


def test_the_pose_that_repeats_worse_is_named_for_the_body_and_for_the_single_reflector(uneven):
    found = of_repeatability(uneven)
    assert set(found) == {"tool", "ball ball0"}
    for row in found.values():
        assert row["verdict"] == "fail"
        assert f" pose p{WORST} " in row["message"]
        assert "no single value" in row["message"]
    assert_between(found["ball ball0"]["value"], 20.0, 90.0)


def test_every_pose_has_its_own_figures_with_an_interval(uneven):
    rows = uneven.tables["pose_repeatability"].to_pylist()
    reported = {(row["subject"], row["pose"], row["figure"]): row for row in rows}
    assert {row["attained"] for row in rows} == {REPEATS}
    for k in range(GROUPS):
        for subject in ("tool", "ball ball0"):
            sigma, rp = reported[subject, f"p{k}", "sigma"], reported[subject, f"p{k}", "RP"]
            assert sigma["low"] < sigma["value"] < sigma["high"]
            assert rp["low"] < rp["value"] < rp["high"]
            own = 300.0 if k == WORST else 10.0
            assert_between(sigma["value"], 0.7 * own, 2.0 * own)
        assert ("tool", f"p{k}", "RP_a") in reported
        # the tool turns far from pose to pose, and by two arc seconds between repeats
        assert reported["tool", f"p{k}", "RP_b"]["value"] < 60.0
    assert ("ball ball0", "p0", "RP_a") not in reported
    wide, narrow = reported["tool", f"p{WORST}", "RP"]["value"], reported["tool", "p0", "RP"]["value"]
    assert_between(wide / narrow, 10.0, 60.0)


def test_pooled_numbers_say_that_they_hold_for_none_and_so_does_the_page(uneven):
    repeats = uneven.tables["repeats"].to_pandas()
    place = repeats[repeats["subject"].isin(["tool x", "tool y", "tool z"])]
    assert (place["p_equal"] < 1e-6).all()
    section = during({name: uneven.tables[name].to_pandas() for name in ("repeats", "pose_repeatability")})
    assert isinstance(section, ReportSection)
    assert any("their pooled scatter represents none of them: tool x" in words for _, words in section.statements)
    (listing,) = (listing for listing in section.listings if listing.held_by == "pose_repeatability.parquet")
    assert len(listing.rows) == 2 * GROUPS
    assert listing.rows[0][:3] == ("tool", "p0", str(REPEATS))


def test_even_repeats_are_reported_together(tmp_path):
    line = written(tmp_path, (0.0, 0.0, 0.0)).call("ingest", "qa")
    for row in of_repeatability(line).values():
        assert row["verdict"] == "pass"
        assert "27 repeats of 3 poses" in row["message"]
        assert "repeat_of" in row["message"]
        assert_between(row["value"], 0.7, 1.3)


def test_a_single_reflector_without_any_body_is_seen_from_the_instrument(tmp_path):
    toml = TOML.replace('[bodies]\nreference = "base"\n', "")
    line = written(tmp_path, (0.01, 0.01, 0.3), toml, ("ball",)).call("ingest", "qa", "pose", "calibrate")
    assert " pose p2 " in of_repeatability(line)["ball ball0"]["message"]
    rows = line.tables["pose_repeatability"].to_pylist()
    assert {row["subject"] for row in rows} == {"ball ball0"}
    done = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert done.exit_code == 0, done.output


def test_a_body_alone_is_seen_from_an_instrument_that_stood_still(tmp_path):
    toml = TOML.replace('[bodies]\nreference = "base"\n', '[measurement]\nframe = "campaign"\n')
    line = written(tmp_path, (0.01, 0.01, 0.3), toml, ("tool",)).call("ingest", "qa", "pose", "calibrate")
    assert_says(of_repeatability(line)["tool"]["message"], "tool", "repeats", "pose p2")
    rows = line.tables["pose_repeatability"].to_pylist()
    assert {(row["subject"], row["figure"]) for row in rows} >= {("tool", "RP"), ("tool", "RP_c")}
    (tmp_path / "campaign.toml").write_text(toml.replace('"campaign"\n', '"pose"\n', 1))
    moved = stage_line(tmp_path).call("ingest", "qa")
    assert [row["verdict"] for row in of_repeatability(moved).values()] == ["not evaluated"]


def test_repeats_that_were_seen_once_are_not_evaluated(tmp_path):
    """Zero repeats are no perfect ones."""
    written(tmp_path, (0.01, 0.01, 0.01))
    path = tmp_path / "points.csv"
    lines = path.read_text().splitlines()
    kept = [line for line in lines if ",tool," not in line or int(line.split(",")[0][1:] or 0) < GROUPS]
    path.write_text("\n".join(kept) + "\n")
    found = of_repeatability(stage_line(tmp_path).call("ingest", "qa"))["tool"]
    assert found["verdict"] == "not evaluated"
    assert found["value"] is None
    assert_says(found["message"], "three poses", "twice")


def test_copies_of_the_scatter_agree_with_numpy(uneven):
    """The ball's sigma is that of its coordinates seen from the base, whose own noise is small next to 0.3 mm."""
    points = uneven.tables["observations"].to_pandas()
    own = points[(points["body"] == "ball") & points["pose"].str[1:].astype(int).mod(GROUPS).eq(WORST)]
    expected = 1e3 * np.sqrt(own[["x_mm", "y_mm", "z_mm"]].var().mean())
    rows = uneven.tables["pose_repeatability"].to_pylist()
    (found,) = (
        r for r in rows if (r["subject"], r["pose"], r["figure"]) == ("ball ball0", f"p{WORST}", "sigma")
    )  # fmt: skip
    assert_close(found["value"], expected, atol=0.05 * expected)
