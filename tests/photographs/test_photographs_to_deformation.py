"""From the sample's photographs to the platform's deformation, compared with the truth at every step."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.blind.generator.folder import truth_path
from tests.blind.generator.quaternions import fit_motion, rotate
from truing.pipeline.in_memory import StageLine, stage_line

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "telescope-images"
POSES, STATIONS = ("0", "1"), 7


@pytest.fixture(scope="module")
def truth() -> Mapping[str, object]:
    found: dict[str, object] = json.loads(truth_path(SAMPLE).read_text(encoding="utf-8"))
    return found


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> StageLine:
    """Two poses with some of their photographs, from the pictures to the deformation."""
    folder = tmp_path_factory.mktemp("photographed") / "telescope-images"
    shutil.copytree(SAMPLE, folder, ignore=lambda _, names: [n for n in names if n.endswith(".jpg")])
    for pose in POSES:
        for photograph in sorted((SAMPLE / "images" / pose).iterdir())[:STATIONS]:
            shutil.copy(photograph, folder / "images" / pose)
    shutil.rmtree(folder / "images" / "2")
    head, *rows = (folder / "configurations.csv").read_text(encoding="utf-8").splitlines()
    kept = [head, *(row for row in rows if row.split(",")[0] in POSES)]
    (folder / "configurations.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    return stage_line(folder).call("images", "bundle", "ingest", "qa", "pose", "deformation")


def test_codes_are_those_in_sight(line: StageLine, truth: Mapping[str, object]) -> None:
    rays = line.tables["image_points"].to_pandas()
    coded = rays[rays.point != ""]
    centres = {
        (str(one["pose"]), one["station"], name): pixel
        for one in truth["photographs"]  # type: ignore[attr-defined]
        for name, pixel in zip(truth["points"], one["pixels"], strict=True)  # type: ignore[call-overload]
    }
    known = coded[coded.point.isin(set(truth["points"]))]  # type: ignore[call-overload]
    # A ring of which a leg hides a part may read as another code: seen once, and in no table.
    assert len(coded) - len(known) <= 0.01 * len(coded)
    station = known.image.str.extract(r"-(\d+)$")[0].astype(int)
    true = np.array([centres[key] for key in zip(known.pose.astype(str), station, known.point, strict=True)])
    off = np.linalg.norm(known[["x_px", "y_px"]].to_numpy() - true, axis=1)
    assert len(off) > 0.7 * 17 * STATIONS * len(POSES)
    # An eccentricity of some hundredths of a pixel is in it.
    assert np.median(off) < 0.03
    assert off.max() < 1.0


def test_measured_target_sizes_agree_with_the_stated_ones(line: StageLine) -> None:
    (row,) = [row for row in line.tables["qa"].to_pylist() if row["check"] == "target-sizes"]
    assert row["subject"] == "circles"
    assert row["value"] < 1.02


def test_object_points_scatter_as_their_covariance_says(line: StageLine, truth: Mapping[str, object]) -> None:
    observed = line.tables["observations"].to_pandas()
    names = {name: k for k, name in enumerate(truth["points"])}  # type: ignore[call-overload]
    assert set(zip(observed.pose.astype(str), observed.body + "/" + observed.target, strict=True)) == {
        (pose, name) for pose in POSES for name in names if not name.startswith("bars/")
    }
    for pose, points in observed.groupby("pose"):
        true = np.array(truth["points_mm"][str(pose)])  # type: ignore[index]
        found = points[["x_mm", "y_mm", "z_mm"]].to_numpy()
        true = true[[names[f"{body}/{target}"] for body, target in zip(points.body, points.target, strict=True)]]
        turn, shift = fit_motion(true, found)
        off = found - rotate(turn, true) - shift
        pulls = off / points[["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]].to_numpy()
        # Errors of a pose hang together: of some hundred coordinates as many as a third count for themselves.
        assert 0.6 < np.sqrt(np.mean(pulls**2)) < 1.5
        assert np.sqrt(np.mean(off**2)) < 0.012


def test_the_attachments_are_seen_to_shift_as_the_platform_deforms(
    line: StageLine, truth: Mapping[str, object]
) -> None:
    seen: pd.DataFrame = line.tables["deformation"].to_pandas()
    shifts = {str(one["pose"]): one["delta_bz_um"] for one in truth["poses"]}  # type: ignore[attr-defined]
    true = np.array([shifts[str(row.pose)][row.leg - 1] for row in seen.itertuples()])
    assert np.abs(true).max() > 70
    agreement = np.sum(((seen.delta_bz_um - true) / seen.sigma_um) ** 2)
    assert agreement < len(true) + 5 * np.sqrt(2 * len(true))
    # Without a deformation the sum would be as many as there are shifts; it is some ten times that.
    assert np.sum((seen.delta_bz_um / seen.sigma_um) ** 2) > 4 * len(true)
