"""`truing init` in the folder of a photogrammetric program: rays take precedence over points computed from them."""

from __future__ import annotations

import tomllib

import pytest

from tests.docs.how_to_pages import FOLDER, examples
from tests.formats.colmap_files import binary
from tests.sentences import assert_says
from truing.pipeline.console import RunConsole
from truing.pipeline.init_campaign import init_campaign

ADJUSTED = "".join(
    f"{n:10d}    573.0039    -49.{n}291   -121.6922      0.0026      0.0029      0.0035 66  1  1  0\n"
    for n in (6, 8, 9)
)


def proposed(folder):
    init_campaign(folder, RunConsole(quiet=False))
    return tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))["files"]


@pytest.mark.parametrize(
    ("page", "number", "tables"),
    [
        ("aicon", 1, {"image_points": "stand.phc", "cameras": "stand.ior", "scale_bars": "stand.scale"}),
        ("colmap", 0, {"image_points": "images.txt", "cameras": "cameras.txt"}),
        ("photomodeler", 0, {"image_points": "export.txt", "cameras": "export.txt"}),
        ("metashape", 1, {"image_points": "markers.xml", "cameras": "markers.xml"}),
    ],
)
def test_every_table_of_a_program_is_proposed(tmp_path, page, number, tables):
    for name, text in examples(FOLDER / f"{page}.md")[number].files.items():
        if name != "campaign.toml":
            (tmp_path / name).write_text(text, encoding="utf-8")
    assert {table: entry["path"] for table, entry in proposed(tmp_path).items()} == tables


def test_points_are_read_only_where_their_rays_are_not(tmp_path):
    (tmp_path / "points3D.bin").write_bytes(binary()["points3D"])
    (tmp_path / "p.obc").write_text(ADJUSTED, encoding="utf-8")
    assert {entry["path"] for entry in proposed(tmp_path)["points"]} == {"points3D.bin", "p.obc"}
    (tmp_path / "campaign.toml").unlink()
    (tmp_path / "images.bin").write_bytes(binary()["images"])
    files = proposed(tmp_path)
    assert set(files) == {"image_points"}
    assert "the rays in the same folder give these points" in (tmp_path / "campaign.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("ending", ["txt", "bin"])
def test_rigs_and_frames_of_a_model_are_no_points(tmp_path, ending, capsys):
    """Files of newer programs next to cameras and images hold lines of numbers that look like coordinates."""
    frame = "1 1 0.96 0.2 0.1 0.1 0.3 -0.2 4.9 1 CAMERA 1 {}"
    frames = "# Frame list with one line of data per frame:\n" + "\n".join(frame.format(n) for n in range(1, 9)) + "\n"
    texts = {"rigs": "# Rig calib list with one line of data per calib:\n1 1 CAMERA 1\n", "frames": frames}
    for name, text in texts.items():
        (tmp_path / f"{name}.{ending}").write_bytes(text.encode() if ending == "txt" else b"\1\0\0\0\0\0\0\0\1")
    (tmp_path / "images.bin").write_bytes(binary()["images"])
    (tmp_path / "points3D.bin").write_bytes(binary()["points3D"])
    assert set(proposed(tmp_path)) == {"image_points"}
    output = capsys.readouterr().out
    assert f"frames.{ending}: no table" in output
    assert_says(output, "points3D.bin", "not read", "rays", "same folder")
