"""A wrong known point is named with its error, and biases neither rays nor poses."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from tests.photographs.machine import photograph
from tests.sentences import says
from tests.stages.line import run_line
from truing.stages.quality.photograph_checks import known_points

SIGMA_MM = 0.01
KNOWN = [f"base/B{number:02d}" for number in (3, 6, 8, 11)]
OFF_MM = 3.0


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("plain") / "rays"
    photograph(folder, poses=2)
    return folder, run_line(folder, "images", "bundle")[0]


def _run(plain: tuple[Path, dict[str, Any]], folder: Path, names: list[str], moved: dict[str, float]) -> dict[str, Any]:
    """The campaign with known points of these names, some of them moved along y by a given number of mm in both
    poses."""
    shutil.copytree(plain[0], folder)
    points = plain[1]["object_points"].to_pandas()
    known = points[points["point"].isin(names)][["pose", "point", "x_mm", "y_mm", "z_mm"]].copy()
    known[["x_mm", "y_mm", "z_mm"]] += np.random.default_rng(2).normal(0.0, SIGMA_MM, (len(known), 3))
    known["y_mm"] += known["point"].map(moved).fillna(0.0)
    known.assign(sigma_x_mm=SIGMA_MM, sigma_y_mm=SIGMA_MM, sigma_z_mm=SIGMA_MM).to_csv(
        folder / "known_points.csv", index=False
    )
    settings = folder / "campaign.toml"
    settings.write_text(f'{settings.read_text()}\n[photographs]\ndatum = "known"\n')
    return run_line(folder, "images", "bundle", "ingest", "qa")[0]


def _checks(tables: dict[str, Any]) -> pd.DataFrame:
    qa = tables["qa"].to_pandas()
    return qa[qa["check"] == "known-points"]


def test_one_wrong_known_point_of_four_is_rejected_with_its_error(
    plain: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    tables = _run(plain, tmp_path / "one", KNOWN, {KNOWN[1]: OFF_MM})
    reported = tables["known_point_errors"].to_pandas().set_index(["pose", "point"])
    assert set(reported[reported["rejected"]].index.get_level_values("point")) == {KNOWN[1]}
    for pose in (1, 2):
        row = reported.loc[(pose, KNOWN[1])]
        off = row[["dx_mm", "dy_mm", "dz_mm"]].to_numpy(float) - [0.0, OFF_MM, 0.0]
        assert np.all(np.abs(off) < 5.0 * row[["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]].to_numpy(float))
    checks = _checks(tables)
    assert set(checks["verdict"]) == {"fail"}
    assert set(zip(checks["value"], checks["limit"], strict=True)) == {(1.0, 0.0)}
    assert all(f"wrong: {KNOWN[1]}," in said or f"rays: {KNOWN[1]}," in said for said in checks["message"])
    assert not any(name in said for said in checks["message"] for name in (KNOWN[0], KNOWN[2], KNOWN[3]))


def test_a_rejected_known_point_keeps_its_rays_and_moves_no_other_point(
    plain: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    wrong = _run(plain, tmp_path / "wrong", KNOWN, {KNOWN[1]: OFF_MM})["object_points"].to_pandas()
    right = plain[1]["object_points"].to_pandas()
    both = right.merge(wrong, on=["pose", "point"], suffixes=("", "_wrong"))
    assert len(both) == len(right)
    assert np.array_equal(both["rays"], both["rays_wrong"])
    apart = both[["x_mm_wrong", "y_mm_wrong", "z_mm_wrong"]].to_numpy() - both[["x_mm", "y_mm", "z_mm"]].to_numpy()
    assert np.abs(apart).max() < 10.0 * SIGMA_MM  # known to that, and continued beyond the four


def test_good_known_points_pass(plain: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    tables = _run(plain, tmp_path / "good", KNOWN, {})
    checks = _checks(tables)
    assert set(checks["verdict"]) == {"pass"}
    assert set(checks["value"]) == {0.0}
    assert not tables["known_point_errors"].column("rejected").to_pandas().any()


def test_one_wrong_known_point_of_three_fails_without_a_name(
    plain: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    tables = _run(plain, tmp_path / "three", KNOWN[:3], {KNOWN[0]: OFF_MM})
    checks = _checks(tables)
    assert set(checks["verdict"]) == {"fail"}
    assert all(says(message, "wrong", "undetermined") for message in checks["message"])
    rejected = tables["image_residuals"].to_pandas()["rejected"].mean()
    assert rejected < 0.01  # no ray goes for it


def test_a_point_without_a_ray_is_not_measured(plain: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    """All rays of a known point lead elsewhere, each to another place: none is left."""
    folder = tmp_path / "spoilt"
    shutil.copytree(plain[0], folder)
    rays = pd.read_csv(folder / "image_points.csv", dtype={"pose": str, "image": str})
    body, target = KNOWN[2].split("/")
    own = (rays["body"] == body) & (rays["target"] == target)
    rays.loc[own, ["x_px", "y_px"]] += np.random.default_rng(5).uniform(-60.0, 60.0, (int(own.sum()), 2))
    rays.to_csv(folder / "image_points.csv", index=False)
    tables = _run((folder, plain[1]), tmp_path / "lost", KNOWN, {})
    points = tables["object_points"].to_pandas()
    assert points["rays"].min() >= 1
    lost = tables["known_point_errors"].to_pandas().query("rays == 0")
    assert set(lost["point"]) == {KNOWN[2]}
    assert KNOWN[2] not in set(points["point"])
    assert all(f"not measured: {KNOWN[2]}" in said for said in _checks(tables)["message"])


@pytest.mark.parametrize(("p_value", "named"), [(0.02, False), (1e-9, True)])
def test_points_that_only_together_differ_too_much_are_not_listed_as_wrong(p_value: float, named: bool) -> None:
    """Stated sigmas are too small for all: each of 30 points differs by what chance allows a single one."""
    off = dict.fromkeys((f"{kind}{axis}_mm" for kind in ("d", "sigma_") for axis in "xyz"), 0.5)
    about = {"pose": 1, "rays": 6, "rejected": False, "reason": "contradicts others; which is wrong is undetermined"}
    rows = [{**off, **about, "point": f"K{k}", "p_value": p_value} for k in range(30)]
    (check,) = known_points(pa.Table.from_pylist(rows))
    assert (check.verdict, check.value, check.limit) == ("fail", 30.0, 0.0)
    assert ("which is wrong" in check.message) == named
    assert ("sigmas too small" in check.message) != named
