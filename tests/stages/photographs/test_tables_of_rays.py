"""Rays measured elsewhere, and prior knowledge: names, sigmas, formats, and faults."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.stages.line import run_line
from truing.schemas.faults import CampaignFaults

TOML = """[campaign]
name = "rays"
kind = "photogrammetry"
[noise]
image_px = 0.05
[[cameras]]
name = "camera"
width_px = 4000
height_px = 3000
focal_px = 4000.0
"""
RAYS = "pose,image,point,x_px,y_px\n1,a,ring12-17,100,200\n1,a,,300,200\n1,b,ring12-17,100.5,210\n"
TARGETS = "family,code,body,target,diameter_mm\nring12,17,platform,P01,5\naruco4x4_50,3,base,M3,\n"


def write(folder: Path, toml: str = TOML, **files: str) -> Path:
    (folder / "campaign.toml").write_text(toml, encoding="utf-8")
    for name, text in {"image_points": RAYS, **files}.items():
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")
    return folder


def faults(folder: Path) -> str:
    with pytest.raises(CampaignFaults) as error:
        run_line(folder, "images")
    return str(error.value)


def test_codes_become_the_targets_that_the_table_says_corners_included(tmp_path: Path) -> None:
    rays = RAYS + "1,b,aruco4x4_50-3.2,5,6\n1,b,ring12-18,7,8\n"
    table = run_line(write(tmp_path, image_points=rays, image_targets=TARGETS), "images")[0]["image_points"]
    named = [tuple(row[key] for key in ("point", "body", "target", "kind")) for row in table.to_pylist()]
    assert named == [
        ("platform/P01", "platform", "P01", "ring12"),
        ("", "", "", "circle"),
        ("platform/P01", "platform", "P01", "ring12"),
        ("base/M3.2", "base", "M3.2", "aruco"),
        ("ring12-18", "", "ring12-18", "ring12"),
    ]


def test_sigmas_are_those_of_the_file_then_those_declared(tmp_path: Path) -> None:
    rays = "pose,image,point,x_px,y_px,sigma_x_px,sigma_y_px\n1,a,p,1,2,0.1,0.2\n1,b,p,3,4,,\n"
    table = run_line(write(tmp_path, image_points=rays), "images")[0]["image_points"]
    assert table.column("cov_xx_px2").to_pylist() == pytest.approx([0.01, 0.0025])
    assert table.column("cov_yy_px2").to_pylist() == pytest.approx([0.04, 0.0025])


def test_bars_and_known_points_are_called_as_points_are(tmp_path: Path) -> None:
    bars = "bar,first,second,length_mm,sigma_mm\nB,ring12-17,ring12-18,500,0.01\n"
    known = "body,target,x_mm,y_mm,z_mm,sigma_x_mm,sigma_y_mm,sigma_z_mm\nplatform,P01,1,2,3,0.1,0.1,0.1\n"
    tables = run_line(write(tmp_path, image_targets=TARGETS, scale_bars=bars, known_points=known), "images")[0]
    assert tables["scale_bars"].to_pylist()[0] | {"serves": "scale"} == tables["scale_bars"].to_pylist()[0]
    assert tables["scale_bars"].column("first").to_pylist() == ["platform/P01"]
    assert tables["known_points"].column("point").to_pylist() == ["platform/P01"]


def test_a_camera_in_mm_is_one_in_pixels(tmp_path: Path) -> None:
    cameras = "camera,width_px,height_px,pixel_um,c_mm,free\ncamera,4000,3000,5,20,c x0 y0\n"
    toml = TOML.split("[[cameras]]")[0]
    table = run_line(write(tmp_path, toml, cameras=cameras), "images")[0]["cameras_given"].to_pandas()
    assert table.set_index("parameter").loc["c", "value"] == pytest.approx(4000.0)
    assert table[table["free"]]["parameter"].tolist() == ["c", "x0", "y0"]


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"image_points": RAYS + "1,b,ring12-17,1,2\n"}, "row 5, column point: found 'ring12-17'; expected each point"),
        ({"image_points": RAYS.replace("100.5", "x")}, "row 4, column x_px: found 'x'"),
        (
            {"image_points": RAYS.replace("210", "3500")},
            "row 4, column y_px: found '3500.0'; expected a position within",
        ),
        (
            {"cameras": "camera,width_px,focal_px\ncamera,4000,4100\n"},
            "key cameras.focal_px: found '4000'; expected 4100, which cameras.csv has of camera camera",
        ),
        ({"cameras": "camera,free\nother,c f\n"}, "cameras.csv, column free: found 'f'; expected names of c x0"),
        ({"scale_bars": "bar,first,second,length_mm,sigma_mm\nB,p,p,500,0\n"}, "expected another point than the first"),
        ({"scale_bars": "bar,first,second,length_mm,sigma_mm\nB,p,q,500,0\n"}, "column sigma_mm: found '0.0'"),
        ({"scale_bars": "bar,first,second,length_mm\nB,p,q,500\n"}, "a column sigma_mm"),
        ({"known_points": "point,x_mm,y_mm,z_mm\np,1,2,3\n"}, "column sigma_x_mm: expected a standard deviation"),
        ({"image_targets": TARGETS + "ring12,17,base,B1,\n"}, "row 4, column code: found '17'; expected every family"),
    ],
)
def test_faults_of_ray_tables_give_their_place(tmp_path: Path, files: dict[str, str], expected: str) -> None:
    assert expected in faults(write(tmp_path, **files))


def test_rays_need_a_format_and_a_sigma(tmp_path: Path) -> None:
    said = faults(write(tmp_path, TOML.split("[noise]")[0]))
    assert "width_px and height_px of camera camera" in said
    assert "key noise.image_px" in said


def test_photographs_and_points_are_not_both_reported(tmp_path: Path) -> None:
    toml = f'{TOML}[files.image_points]\npath = "image_points.csv"\n'
    write(tmp_path, toml, points="pose,body,target,x_mm,y_mm,z_mm\n1,b,t,1,2,3\n")
    with pytest.raises(CampaignFaults, match=r"either photographs .* or points, not both"):
        run_line(tmp_path, "ingest")


def test_rays_that_make_no_network_are_a_fault_that_says_why(tmp_path: Path) -> None:
    with pytest.raises(CampaignFaults, match="rays that make a network"):
        run_line(write(tmp_path), "images", "bundle")


def test_a_plan_of_uncoded_circles_is_reported_to_need_codes(tmp_path: Path) -> None:
    with pytest.raises(CampaignFaults, match=r"targets with a code or a name, .* none of 3 rays has one"):
        run_line(write(tmp_path, image_points=RAYS.replace("ring12-17", "")), "images", "bundle")


def test_a_camera_of_the_table_and_of_the_settings_has_the_values_of_both(tmp_path: Path) -> None:
    cameras = "camera,width_px,height_px,pixel_um,c_mm,A1,free\ncamera,4000,3000,5,20,1e-9,c x0 y0 A1\n"
    toml = TOML.split("width_px")[0] + 'x0_px = 3.0\nfree = ["c"]\n'
    table = run_line(write(tmp_path, toml, cameras=cameras), "images")[0]["cameras_given"].to_pandas()
    values = table.set_index("parameter")["value"]
    assert values[["c", "x0", "A1"]].tolist() == pytest.approx([4000.0, 3.0, 1e-9])
    assert table[table["free"]]["parameter"].tolist() == ["c"]
    assert set(table["width_px"]) == {4000}


def test_a_camera_is_named_once_in_the_settings(tmp_path: Path) -> None:
    said = faults(write(tmp_path, TOML + TOML[TOML.index("[[cameras]]") :]))
    assert "key cameras.name: found 'camera'; expected each camera once" in said


GROUP = '[[cameras]]\nname = "refocused"\nof = "camera"\n'


def test_photographs_of_a_group_are_by_a_camera_of_their_own(tmp_path: Path) -> None:
    rays = RAYS + "2,a,ring12-17,100,200\n2,b,ring12-17,100,200\n"
    toml = f'{TOML}{GROUP}poses = [2]\nimages = ["b", "c"]\nfree = ["c"]\n'
    tables = run_line(write(tmp_path, toml, image_points=rays), "images")[0]
    keys = ("pose", "image", "camera")
    for name in ("image_points", "photographs"):
        own = {row["camera"]: (row["pose"], row["image"]) for row in tables[name].select(keys).to_pylist()}
        assert own.pop("refocused") == (2, "b")
        assert set(own) == {"camera"}
    given = tables["cameras_given"].to_pandas().set_index(["camera", "parameter"])
    assert given.loc[("refocused", "c"), "value"] == 4000.0
    assert given["free"].groupby("camera").sum().to_dict() == {"camera": 10, "refocused": 1}


@pytest.mark.parametrize(
    ("group", "expected"),
    [
        (
            f"{GROUP}poses = [7]\n",
            "cameras.of: found 'camera'; expected poses or images of photographs by camera camera",
        ),
        (
            f'{GROUP}images = ["a"]\n{GROUP.replace("refocused", "third")}poses = [1]\n',
            "cameras.images: found 'refocused, third'; expected one camera for image a of pose 1",
        ),
        (GROUP, "poses or images with the key of"),
        (f"{GROUP.replace(chr(34) + 'camera', chr(34) + 'refocused')}poses = [1]\n", "a name other than that"),
        ('[[cameras]]\nname = "a"\nposes = [1]\n', 'for the camera of these photographs: of = "camera"'),
    ],
)
def test_faults_of_a_camera_group_are_named(tmp_path: Path, group: str, expected: str) -> None:
    assert expected in faults(write(tmp_path, TOML + group))
