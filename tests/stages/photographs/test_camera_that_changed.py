"""A camera that changed between images: the images concerned, the effect on points, and separate cameras for them."""

from __future__ import annotations

import re
import shutil
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.photographs.machine import photograph
from tests.stages.line import run_line

ZOOM = 1.003
LINE = ("images", "bundle", "ingest", "qa")


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("plain") / "rays"
    photograph(folder, poses=3)
    return folder, run_line(folder, *LINE)[0]


def _zoomed(plain: Path, folder: Path, choose: Callable[[Sequence[str]], Sequence[str]]) -> set[str]:
    """A copy of a campaign in which the image coordinates of some photographs grow about the middle of the format."""
    shutil.copytree(plain, folder)
    rays = pd.read_csv(folder / "image_points.csv", dtype={"image": str})
    camera = pd.read_csv(folder / "cameras.csv").iloc[0]
    images = set(choose(list(dict.fromkeys(rays["image"]))))
    own = rays["image"].isin(images)
    for column, side in (("x_px", "width_px"), ("y_px", "height_px")):
        middle = (camera[side] - 1) / 2
        rays.loc[own, column] = middle + ZOOM * (rays.loc[own, column] - middle)
    rays.to_csv(folder / "image_points.csv", index=False)
    return images


def _check(tables: dict[str, Any]) -> pd.DataFrame:
    qa = tables["qa"].to_pandas()
    return qa[qa["check"] == "camera-stability"]


def test_a_camera_that_stayed_as_it_was_has_one_setting(plain: tuple[Path, dict[str, Any]]) -> None:
    images = plain[1]["image_cameras"].to_pandas()
    assert set(images["setting"]) == {0}
    assert set(_check(plain[1])["verdict"]) == {"pass"}
    off = images["principal_distance_off_px"] / images["principal_distance_sigma_px"]
    assert np.abs(off).max() < 5.0


@pytest.mark.parametrize(("spread", "verdict"), [(0.0, "pass"), (0.002, "warn")])
def test_one_pose_shows_whether_a_principal_distance_fits_all_photographs(
    tmp_path: Path, spread: float, verdict: str
) -> None:
    """A lens that moves from photograph to photograph: no few photographs are the cause, and there is no other pose."""
    photograph(tmp_path / "rays", poses=1)
    rng, file = np.random.default_rng(2), tmp_path / "rays" / "image_points.csv"
    rays = pd.read_csv(file, dtype={"image": str})
    camera = pd.read_csv(tmp_path / "rays" / "cameras.csv").iloc[0]
    zoom = {image: 1.0 + spread * rng.uniform(-1.0, 1.0) for image in dict.fromkeys(rays["image"])}
    for column, side in (("x_px", "width_px"), ("y_px", "height_px")):
        middle = (camera[side] - 1) / 2
        rays[column] = middle + rays["image"].map(zoom) * (rays[column] - middle)
    rays.to_csv(file, index=False)
    (check,) = _check(run_line(tmp_path / "rays", *LINE)[0]).to_dict("records")
    assert check["verdict"] == verdict
    assert (check["value"] < 1e-3) == (verdict == "warn")


@pytest.mark.parametrize(
    ("choose", "expected"),
    [
        (lambda names: names[3:9], "01-04 of pose 1, 01-05 of pose 1"),
        (lambda names: [name for name in names if name.startswith("02")], "all of pose 2"),
    ],
)
def test_images_that_were_zoomed_are_named_and_have_a_camera_of_their_own(
    plain: tuple[Path, dict[str, Any]], tmp_path: Path, choose: Callable[[Sequence[str]], Sequence[str]], expected: str
) -> None:
    folder = tmp_path / "zoomed"
    zoomed = _zoomed(plain[0], folder, choose)
    tables = run_line(folder, *LINE)[0]
    images = tables["image_cameras"].to_pandas()
    assert set(images[images["setting"] > 0]["image"]) == zoomed
    (row,) = _check(tables).itertuples()
    assert row.verdict == "fail"
    assert expected in row.message
    cure = re.search(r"\[\[cameras\]\] (.*)\.$", row.message)
    assert cure is not None
    keys = re.sub(r", (?=[a-z]+ = )", "\n", cure[1])
    assert tomllib.loads(keys)["of"] == "camera"
    settings = folder / "campaign.toml"
    settings.write_text(f"{settings.read_text()}\n[[cameras]]\n{keys}\n")
    cured = run_line(folder, *LINE)[0]
    assert set(_check(cured)["verdict"]) <= {"pass", "not evaluated"}
    assert set(cured["image_cameras"].to_pandas()["setting"]) == {0}
    both = (
        cured["object_points"]
        .to_pandas()
        .merge(plain[1]["object_points"].to_pandas(), on=["pose", "point"], suffixes=("", "_plain"))
    )
    assert len(both) == plain[1]["object_points"].num_rows
