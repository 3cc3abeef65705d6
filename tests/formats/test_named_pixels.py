"""Lists of pixels are proposed as image points, by whatever names; the truth of each list was written down first."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.tolerance import assert_close
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import IMAGE_POINTS
from truing.formats.row_collection import collect_rows
from truing.formats.source import CampaignFiles
from truing.pipeline.command_line import app
from truing.schemas.campaign import read_campaign

NAMES = [f"T{k:02d}" for k in range(1, 9)]
AT = np.round(np.random.default_rng(6).uniform(60.0, 2900.0, (3, len(NAMES), 2)), 3)  # image, target, x and y


def one_list(heads: str, separator: str, order: str) -> str:
    """All images in one file; ``order`` of image (i), target (t), x and y."""
    lines = [heads]
    for image, places in enumerate(AT, 412):
        for name, (x, y) in zip(NAMES, places.tolist(), strict=True):
            cells = {"i": f"IMG_{image}", "t": name, "x": f"{x:.3f}", "y": f"{y:.3f}"}
            lines.append(separator.join(cells[which] for which in order))
    return "\n".join(lines) + "\n"


def of_one_image(heads: str, places: np.ndarray) -> str:
    rows = [f"{name},{x:.3f},{y:.3f}" for name, (x, y) in zip(NAMES, places.tolist(), strict=True)]
    return "\n".join([heads, *rows]) + "\n"


def read(folder: Path, files: dict[str, str]) -> tuple[list[str], list[str], list[str], np.ndarray]:
    """Poses, images, names of points, and coordinates by the entries that `truing init` proposes."""
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    done = CliRunner().invoke(app, ["init", str(folder)])
    assert done.exit_code == 0, done.output
    document = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))
    log = FaultLog()
    rows = collect_rows(CampaignFiles(folder, read_campaign(document)), IMAGE_POINTS, log)
    assert not log
    assert rows is not None
    texts = [list(map(str, rows.table.column(name).to_pylist())) for name in ("pose", "image", "point")]
    places = np.column_stack([rows.table.column(name).to_pylist() for name in ("x_px", "y_px")])
    return texts[0], texts[1], texts[2], places


@pytest.mark.parametrize(
    ("heads", "separator", "order"),
    [
        ("Image;Point;x [px];y [px]", ";", "itxy"),
        ("image,target,u,v", ",", "itxy"),
        ("# image  target  col  row", " ", "itxy"),
        ("Photo\tMarker\tx (pix)\ty (pix)", "\t", "itxy"),
        ("Bild;Punkt;Zeile;Spalte", ";", "ityx"),
        ("point,image,x,y", ",", "tixy"),
    ],
)
def test_a_list_of_all_images_is_read(tmp_path: Path, heads: str, separator: str, order: str) -> None:
    poses, images, points, places = read(tmp_path / "list", {"pixels.txt": one_list(heads, separator, order)})
    assert set(poses) == {"1"}
    assert images == [f"IMG_{image}" for image in (412, 413, 414) for _ in NAMES]
    assert points == 3 * NAMES
    assert_close(places, AT.reshape(-1, 2), atol=1e-9)


def test_names_of_files_show_images_and_poses(tmp_path: Path) -> None:
    files = {
        f"pose{pose}_image{image}.csv": of_one_image("id,px,py", AT[image - 1])
        for pose in (1, 2)
        for image in (1, 2, 3)
    }
    poses, images, _, places = read(tmp_path / "poses", files)
    assert poses == [str(pose) for pose in (1, 2) for _ in range(3 * len(NAMES))]
    assert images == 2 * [str(image) for image in (1, 2, 3) for _ in NAMES]
    assert_close(places, np.tile(AT.reshape(-1, 2), (2, 1)), atol=1e-9)


def test_a_file_for_each_image_is_an_image_of_one_pose(tmp_path: Path) -> None:
    files = {f"DSC000{image}.csv": of_one_image("Target,u_px,v_px", AT[image - 1]) for image in (1, 2, 3)}
    poses, images, _, _ = read(tmp_path / "images", files)
    assert set(poses) == {"1"}
    assert list(dict.fromkeys(images)) == ["0001", "0002", "0003"]


@pytest.mark.parametrize("heads", ["point,x,y,z", "id,x_mm,y_mm", "name,u,v,w"])
def test_other_coordinates_are_no_pixels(tmp_path: Path, heads: str) -> None:
    columns = heads.count(",")
    places = AT.reshape(-1, 6)[:, :columns].tolist()
    rows = [",".join([name, *map(str, row)]) for name, row in zip(NAMES, places, strict=True)]
    (tmp_path / "list.csv").write_text("\n".join([heads, *rows]) + "\n", encoding="utf-8")
    CliRunner().invoke(app, ["init", str(tmp_path)])
    files = tomllib.loads((tmp_path / "campaign.toml").read_text(encoding="utf-8")).get("files", {})
    assert "image_points" not in files
