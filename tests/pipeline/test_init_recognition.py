"""`truing init`: files that it recognises, and the entries that it proposes for them."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.disguise import dense_scans, german
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Targets
from tests.blind.generator.schedule import at_rest, random_moves
from tests.pipeline.init_calls import NUMBERS, PLACED, TURNED, init, rows, starter, written
from tests.sentences import assert_says
from truing.pipeline.command_line import app


def test_german_numbers_and_a_file_per_pose(tmp_path: Path) -> None:
    for pose in range(3):
        lines = ["Punktnummer;X;Y;Z", *(f"P{k};1{k},5;2{k},25;-{k},125" for k in range(5))]
        (tmp_path / f"aufnahme_{pose:02d}.txt").write_text("\n".join(lines), encoding="latin-1")
    assert init(tmp_path).exit_code == 0
    entry = written(tmp_path)["files"]["points"]
    assert entry["path"] == "aufnahme_*.txt"
    assert (entry["separator"], entry["decimal"]) == (";", ",")
    assert entry["columns"]["x_mm"] == "X"
    assert re.fullmatch(entry["from_name"], "aufnahme_01.txt")["pose"] == "01"  # type: ignore[index]


def test_two_kinds_of_files_for_one_table_become_two_entries(tmp_path: Path) -> None:
    (tmp_path / "first.csv").write_text("pose,body,target,x_mm,y_mm,z_mm\n1,base,A,1.0,2.0,3.0\n")
    (tmp_path / "second.csv").write_text("pose;body;target;x_mm;y_mm;z_mm\n2;base;A;1,0;2,0;3,0\n")
    assert init(tmp_path).exit_code == 0
    assert [entry["path"] for entry in written(tmp_path)["files"]["points"]] == ["first.csv", "second.csv"]


def test_an_unrecognised_file_is_left_as_a_comment(tmp_path: Path) -> None:
    (tmp_path / "notes.bin").write_bytes(bytes(range(256)))
    done = init(tmp_path)
    assert done.exit_code == 0
    assert "notes.bin: not recognised" in done.stdout
    assert "files" not in written(tmp_path)


@pytest.mark.parametrize(
    ("table", "header"),
    [
        ("displacement", "run,step,time_s,fx_n,fy_n,fz_n,mx_nm,my_nm,mz_nm,dx_mm,dy_mm,dz_mm,rx_rad,ry_rad,rz_rad"),
        ("signals", "run,step,fx_n,fz_n,v1_mv,v2_mv"),
    ],
)
def test_a_table_of_loads_makes_an_interferometer_campaign(tmp_path: Path, table: str, header: str) -> None:
    (tmp_path / f"{table}.csv").write_text(f"{header}\n{','.join('0' * (header.count(',') + 1))}\n")
    assert init(tmp_path).exit_code == 0
    assert written(tmp_path)["campaign"]["kind"] == "interferometer"


SMALL = Layout(name="small", targets=Targets(base=6, platform=6, per_leg=0))


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    moves = random_moves(3, 0, np.random.default_rng(1))
    campaign = draw_campaign(SMALL, [at_rest(), *moves], [], np.random.default_rng(2))
    return write_campaign(campaign, tmp_path_factory.mktemp("small") / "campaign", seed=2)


def faultless_once_the_noise_is_declared(folder: Path) -> bool:
    """Return True if the proposal of `truing init` has no fault once the user adds the noise."""
    (folder / "campaign.toml").unlink()
    assert init(folder).exit_code == 0
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    (folder / "campaign.toml").write_text(text.replace("# point_mm", "point_mm"), encoding="utf-8")
    done = CliRunner().invoke(app, ["check", str(folder)])
    assert done.exit_code == 0, done.output
    return True


def test_a_german_spreadsheet_needs_no_hand(small: Path, tmp_path: Path) -> None:
    folder = german(small, tmp_path / "german")
    assert faultless_once_the_noise_is_declared(folder)
    files = written(folder)["files"]
    assert files["configurations"]["columns"]["rho6_mm"] == "Stößel 6"
    assert files["targets"]["columns"]["leg"] == "Bein"


def test_clouds_of_many_points_are_scans_and_the_single_ones_their_surfaces(tmp_path: Path) -> None:
    """At rest and in one pose: each further one is two registrations more."""
    moves = random_moves(1, 0, np.random.default_rng(1))
    campaign = draw_campaign(SMALL, [at_rest(), *moves], [], np.random.default_rng(2))
    folder = dense_scans(
        write_campaign(campaign, tmp_path / "campaign", seed=2),
        tmp_path / "scans",
        np.random.default_rng(3),
        count=2000,
    )
    assert faultless_once_the_noise_is_declared(folder)
    files = written(folder)["files"]
    assert [entry["constants"]["body"] for entry in files["scans"]] == ["base", "platform"]
    assert [entry["constants"]["body"] for entry in files["surfaces"]] == ["base", "platform"]


def test_points_alone_need_the_noise_alone(small: Path, tmp_path: Path) -> None:
    shutil.copy(small / "points.csv", tmp_path)
    (tmp_path / "campaign.toml").touch()
    assert faultless_once_the_noise_is_declared(tmp_path)


BUNDLES = ("20250221_Bundle5.csv", "20250221_Bundle6.csv", "20250221_Set03.csv")

TRACKER = ("M2_Lower_Left_step_start40.txt", "M2_Lower_Right_step_start40.txt", "M2_Upper_Left_step_start_40deg.txt")

ROBOT = tuple(f"measured_{body}_{k}.txt" for body in ("SMR", "base") for k in (1, 2, 3))

VSTARS = "CODE1,1.5,2.5,3.5,0.04,0.03,0.02,0.000\nCODE2,4.5,2.5,7.5,0.1,0.1,0.1,0.0\n"

HEAD = "Enabled\tFeature\tID\tx\ty\tz\nChecked\t{name}\t1\t-5,231.6\t-2,701.0\t1,263.7\n"


def proposed(folder: Path, names: tuple[str, ...], text: str) -> Any:
    """The entry for files with these names and a text each, several where they are not read alike."""
    folder.mkdir(exist_ok=True)
    for k, name in enumerate(names):
        (folder / name).write_text(text.format(name=name, k=k))
    assert init(folder).exit_code == 0
    return next(iter(written(folder)["files"].values()))


def groups_in_names(entry: dict[str, Any], names: tuple[str, ...]) -> list[dict[str, str]]:
    return [match.groupdict() for name in names if (match := re.search(entry["from_name"], name))]


@pytest.mark.parametrize(
    ("names", "poses"),
    [
        (BUNDLES, ["Bundle5", "Bundle6", "Set03"]),
        (("20250401_Set_06.csv", "20250402_Set_09.csv"), ["06", "09"]),
        (("20250401_Set_01.csv", "20250402_Set_01.csv"), ["20250401", "20250402"]),
        (("20250820_Set35_Bundle4.csv", "20250615_Set_34.csv"), ["20250820_Set35_Bundle4", "20250615_Set_34"]),
        (("run.csv", "run_2.csv"), ["run", "run_2"]),
    ],
)
def test_files_that_are_read_alike_are_one_entry_and_their_names_the_poses(
    tmp_path: Path, names: tuple[str, ...], poses: list[str]
) -> None:
    entry = proposed(tmp_path / "raw", names, VSTARS)
    assert [one["pose"] for one in groups_in_names(entry, names)] == poses
    assert sorted(path.name for path in (tmp_path / "raw").glob(entry["path"])) == sorted(names)


def test_a_trackers_lists_of_one_target_each_show_body_and_target_by_their_names(tmp_path: Path) -> None:
    entry = proposed(tmp_path / "raw", TRACKER, HEAD)
    assert [(one["body"], one["target"]) for one in groups_in_names(entry, TRACKER)] == [
        ("M2", "Lower_Left"),
        ("M2", "Lower_Right"),
        ("M2", "Upper_Left"),
    ]
    both = (*TRACKER, "LATR_1_step_5deg.txt", "LATR_2_step_5deg.txt")
    entry = proposed(tmp_path / "both", both, HEAD)
    assert [(one["body"], one["target"]) for one in groups_in_names(entry, both)[3:]] == [("LATR", "1"), ("LATR", "2")]


def test_a_few_long_files_of_bare_coordinates_are_targets_and_their_rows_poses(tmp_path: Path) -> None:
    rows = "".join(f"{2641 + row}.{{k}} {162.2 - row} {-7.8 * row}\n" for row in range(60))
    entry = proposed(tmp_path / "raw", ROBOT, rows)
    assert entry["number_rows"] == {"pose": 1}
    assert [(one["body"], one["target"]) for one in groups_in_names(entry, ROBOT)[2:4]] == [("SMR", "3"), ("base", "1")]
    text = (tmp_path / "raw" / "campaign.toml").read_text()
    (tmp_path / "raw" / "campaign.toml").write_text(text.replace("# point_mm", "point_mm"))
    done = CliRunner().invoke(app, ["check", str(tmp_path / "raw")])
    assert done.exit_code == 0, done.output
    assert "360 points of 60 poses" in done.stdout
    assert "6 files" in done.stdout


def test_only_coded_targets_of_a_bundle_are_proposed(tmp_path: Path) -> None:
    entry = proposed(tmp_path / "raw", BUNDLES, VSTARS + "TARGET36,-12.5,4.5,-1.5,0.2,1.4,0.1,0.000\n")
    assert entry["select"] == {"target": r"CODE\d+"}
    assert "select" not in proposed(tmp_path / "coded", BUNDLES, VSTARS)


def test_a_time_of_an_unknown_notation_is_answered_with_the_key_that_reads_it(tmp_path: Path) -> None:
    log = "t,x_displacement,x_force,y_force\n20-Dec-2008 10:47:39.2,0.5,0.5,0.5\n20-Dec-2008 10:47:41.7,1,1,1\n"
    entry = proposed(tmp_path, ["log.csv"], log)
    assert entry["time_format"] == "%d-%b-%Y %H:%M:%S.%f"
    (tmp_path / "log.csv").write_text(log.replace("20-Dec-2008 ", "20 XII 2008 "))
    done = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert "'20 XII 2008 10:47:39.2'" in done.stderr
    assert "expected a time written as %d-%b-%Y" in done.stderr


def test_files_next_to_those_that_a_glob_would_find_are_not_taken_along(tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "20250221_notes.csv").write_text("who,when\nAnn,today\n")
    entries = proposed(tmp_path / "raw", BUNDLES, VSTARS)
    assert [entry["path"] for entry in entries] == ["*_Bundle*.csv", "20250221_Set03.csv"]


@pytest.mark.parametrize(
    ("header", "table", "columns"),
    [
        ("Fx,Fy,Fz,known_Fx,known_Fy,known_Fz", "signals", {"v1_mv": "Fx", "fx_n": "known_Fx"}),
        ("t,x_displacement,x_force,y_moment", "displacement", {"dx_mm": "x_displacement", "my_nm": "y_moment"}),
        ("Time (s),Fx (N),Fy (N),Mz (Nmm)", "signals", {"time_s": "Time (s)", "shown_mz_nm": "Mz (Nmm)"}),
    ],
)
def test_forces_are_no_coordinates(tmp_path: Path, header: str, table: str, columns: dict[str, str]) -> None:
    text = f"{header}\n" + f"{','.join('0.5' for _ in header.split(','))}\n" * 3
    (tmp_path / "raw").mkdir()
    entry = proposed(tmp_path / "raw", ("log.csv",), text)
    document = written(tmp_path / "raw")
    assert list(document["files"]) == [table]
    assert document["campaign"]["kind"] == "interferometer"
    assert columns.items() <= entry["columns"].items()
    assert entry.get("units", {}).get("shown_mz_nm") == ("N mm" if "Nmm" in header else None)


def test_phases_of_a_quadrature_log_are_read_as_proposed(tmp_path: Path) -> None:
    text = "Phase (deg),Radius\n" + "".join(f"{30.0 * k % 360:.1f},{500.0 + k % 3}\n" for k in range(40))
    entry = proposed(tmp_path / "raw", ("scan_X.csv",), text)
    assert entry["constants"] == {"run": "1", "channel": "dz", "load_axis": "fz", "load": 0}
    done = CliRunner().invoke(app, ["check", str(tmp_path / "raw")])
    assert (done.exit_code, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("names", "path", "mapping"),
    [
        (("images/1/a.jpg", "images/2/a.jpg"), None, {}),
        (("shots/1/a.jpg", "shots/2/a.jpg"), "shots/**/*.jpg", {"from_name": "(?P<pose>[^/]+)/[^/]+$"}),
        (("shots/up_1.png", "shots/up_2.png"), "shots/*.png", {"from_name": r"^(?P<pose>.+)[-_ ]\d+\."}),
        (("s/IMG_p01_1.JPG", "s/IMG_p02_1.JPG"), "s/*.JPG", {"from_name": r"^IMG_p(?P<pose>\d+)[-_ ]\d+\."}),
        (("a.JPG", "b.JPG"), "*.JPG", {"constants": {"pose": 1}}),
    ],
)
def test_photographs_are_found_with_what_shows_their_pose(
    tmp_path: Path, names: tuple[str, ...], path: str | None, mapping: dict[str, Any]
) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"\xff\xd8\xff")
    (tmp_path / "scale_bars.csv").write_text("bar,first,second,length_mm,sigma_mm\nB,p,q,500,0.01\n")
    assert init(tmp_path).exit_code == 0
    found = written(tmp_path).get("files", {})
    assert "points" not in found
    assert found.get("images") == (None if path is None else {"path": path, **mapping})
    assert written(tmp_path)["campaign"]["kind"] == "photogrammetry"


@pytest.mark.parametrize("number", ["_1", ""])
def test_folders_of_a_pose_each_are_not_one_pose(tmp_path: Path, number: str) -> None:
    for pose in ("1", "2"):
        (tmp_path / pose).mkdir()
        (tmp_path / pose / f"IMG{number}.jpg").write_bytes(b"\xff\xd8\xff")
    assert init(tmp_path).exit_code == 0
    entries = written(tmp_path)["files"]["images"]
    poses = [re.search(entry["from_name"], entry["path"])["pose"] for entry in entries]  # type: ignore[index]
    assert poses == ["1", "2"]


@pytest.mark.parametrize(
    ("header", "numbers", "columns", "more"),
    [
        ("x,y,z,qw,qx,qy,qz", TURNED.as_quat(scalar_first=True), {"qw": "qw"}, {}),
        ("x,y,z,rx,ry,rz", TURNED.as_rotvec(), {"rx_rad": "rx"}, {}),
        ("x,y,z,rx,ry,rz", TURNED.as_euler("XYZ", degrees=True), {"euler_a_deg": "rx"}, {}),
        ("x [m],y [m],z [m],rx [rad],ry [rad],rz [rad]", TURNED.as_rotvec(), {"rx_rad": "rx [rad]"}, {"unit": "m"}),
    ],
)
def test_positions_with_attitudes_are_poses(
    tmp_path: Path, header: str, numbers: Any, columns: dict[str, str], more: dict[str, str]
) -> None:
    _, document = starter(tmp_path, {"log.csv": f"{header}\n" + rows(*PLACED.T, *numbers.T)})
    entry = document["files"]["poses"]
    assert columns.items() <= entry["columns"].items()
    assert entry.get("unit") == more.get("unit")
    assert "points" not in document["files"]


def test_measured_poses_are_distinguished_from_commanded_ones_with_their_sigmas_and_joints(tmp_path: Path) -> None:
    header = "Goal x,Goal y,Goal z,Goal roll,Goal pitch,Goal yaw,elbow,measured_x,measured_y,measured_z"
    header += ",measured_rx,measured_ry,measured_rz,measured_std_x,measured_std_y,measured_std_z"
    angles = TURNED.as_euler("XYZ", degrees=True)
    text, document = starter(
        tmp_path,
        {"log.csv": f"{header}\n" + rows(*PLACED.T, *angles.T, range(8), *PLACED.T, *angles.T, *np.full((3, 8), 0.01))},
    )
    entry = document["files"]["poses"]["columns"]
    assert (entry["x_mm"], entry["euler_c_deg"], entry["sigma_z_mm"]) == ("measured_x", "measured_rz", "measured_std_z")
    assert "# euler = " in text
    fixed = re.sub(r"^# (rotation_rad|euler)", r"\1", text, flags=re.MULTILINE)
    (tmp_path / "campaign.toml").write_text(fixed)
    done = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "8 measured poses" in done.stdout


def test_matrices_are_poses_and_one_alone_is_a_transformation(tmp_path: Path) -> None:
    whole = np.tile(np.eye(4), (8, 1, 1))
    whole[:, :3, :3], whole[:, :3, 3] = TURNED.as_matrix(), PLACED
    np.savetxt(tmp_path / "T.txt", whole.reshape(8, 16))
    np.savetxt(tmp_path / "blocks.txt", whole.reshape(-1, 4))
    np.savetxt(tmp_path / "handeye.txt", whole[0])
    text, document = starter(tmp_path, {})
    entries = {entry["path"]: entry for entry in document["files"]["poses"]}
    assert entries["T.txt"]["columns"]["m23"] == 12
    assert entries["blocks.txt"]["rows_per_pose"] == 4
    assert "handeye.txt: a single rigid motion" in text
    assert "points" not in document["files"]


@pytest.mark.parametrize(
    ("header", "columns"),
    [
        ("Fx,Fy,Fz,Mx,My,Mz", {"fx_n": "Fx", "mz_nm": "Mz"}),
        ("Fx,Fy,Fz,Mx,My,Mz,s0,s1,s2,s3", {"fx_n": "Fx", "v1_mv": "s0", "v4_mv": "s3"}),
        ("force_x,force_y,force_z,sensor_x,sensor_y,sensor_z", {"fx_n": "force_x", "v3_mv": "sensor_z"}),
    ],
)
def test_loads_are_what_acted_and_not_what_a_sensor_shows(tmp_path: Path, header: str, columns: dict[str, str]) -> None:
    cells = [[0.5 * k for _ in header.split(",")] for k in range(4)]
    _, document = starter(tmp_path, {"loads.csv": f"{header}\n" + rows(*zip(*cells, strict=True))})
    entry = document["files"]["signals"]
    assert columns.items() <= entry["columns"].items()
    assert not any(name.startswith("shown_") for name in entry["columns"])


def test_columns_of_numbers_without_names_are_no_coordinates_where_there_are_six(tmp_path: Path) -> None:
    text, document = starter(tmp_path, {"readings.txt": rows(*NUMBERS.uniform(-90, 90, (6, 8)).round(3))})
    assert "files" not in document
    assert "6 columns of numbers without names" in text


def test_numbers_of_targets_are_no_coordinate(tmp_path: Path) -> None:
    _, document = starter(tmp_path, {"survey.txt": rows(range(1, 9), *PLACED.round().astype(int).T)})
    (table,) = document["files"]
    assert document["files"][table]["columns"] == {"target": 1, "x_mm": 2, "y_mm": 3, "z_mm": 4}


def test_metres_stay_metres_and_expanded_uncertainties_keep_their_factor(tmp_path: Path) -> None:
    header = "pose,target,X [m],Y [m],Z [m],UX [mm],UY [mm],UZ [mm]"
    rows = "".join(f"1,{name},0.{at},0.{at**2},0.3,0.02,0.02,0.02\n" for at, name in enumerate("ABC", 1))
    text, document = starter(tmp_path, {"points_.csv": f"{header}\n{rows}"})
    entry = document["files"]["points"]
    assert (entry["unit"], entry["coverage"]) == ("m", 2.0)
    assert entry["units"] == {f"sigma_{a}_mm": "mm" for a in "xyz"}
    assert "k = 2 is taken" in text
    (tmp_path / "campaign.toml").write_text(text.replace("[[files", "[files") + 'constants = { body = "b" }\n')
    done = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert done.exit_code == 0, done.output


def test_the_same_fault_in_many_files_is_one_message_with_a_count(tmp_path: Path) -> None:
    for number in range(40):
        (tmp_path / f"pose_{number}.csv").write_text("target,x_mm,y_mm,z_mm\nA,1,2,3\nB,x,5,6\n")
    (tmp_path / "campaign.toml").write_text(
        '[campaign]\nname = "c"\nkind = "photogrammetry"\n[noise]\npoint_mm = 0.01\n[files.points]\n'
        'path = "pose_*.csv"\nfrom_name = \'pose_(?P<pose>\\d+)\'\nconstants = { body = "b" }\n'
    )
    done = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert_says(line, "pose_0.csv", "row 3", "column x_mm", "found 'x'", "number")
    assert_says(line, "39 more", "39 other files")


def test_a_sheet_of_a_workbook_is_proposed_as_it_is_read(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="not installed")
    book = openpyxl.Workbook()
    book.active.title = "Messdaten"
    book.active.append(["Projekt"])
    book.active.append(["Pose", "Punkt", "X [m]", "Y [m]", "Z [m]", "U(95) X [mm]"])
    for number in range(4):
        book.active.append([1, f"P{number}", 0.1 * number, 0.2, 0.3, 0.02])
    book.create_sheet("Notizen").append(["gut"])
    book.save(tmp_path / "Protokoll.xlsx")
    text, document = starter(tmp_path, {})
    entry = document["files"]["points"]
    assert (entry["sheet"], entry["unit"], entry["coverage"]) == ("Messdaten", "m", 2.0)
    (tmp_path / "campaign.toml").write_text(re.sub(r"^# (point_mm|constants)", r"\1", text, flags=re.MULTILINE))
    done = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert done.exit_code == 0, done.output


def test_a_stack_of_matrices_of_matlab_is_proposed_as_poses(tmp_path: Path) -> None:
    whole = np.tile(np.eye(4)[:, :, None], (1, 1, 8))
    whole[:3, :3], whole[:3, 3] = np.moveaxis(TURNED.as_matrix(), 0, -1), PLACED.T
    savemat(tmp_path / "T.mat", {"T": whole, "note": "tracker"})
    text, document = starter(tmp_path, {})
    assert document["files"]["poses"]["variable"] == "T"
    (tmp_path / "campaign.toml").write_text(re.sub(r"^# (\w+_(mm|rad) =)", r"\1", text, flags=re.MULTILINE))
    done = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "8 measured poses" in done.stdout


@pytest.mark.parametrize(
    ("names", "other", "path"),
    [
        (("cell1", "cell2", "cell12"), "cell2_validation", ["cell[0-9].csv", "cell[0-9][0-9].csv"]),
        (("SMR_1", "SMR_2"), "SMR_base", "SMR_[0-9].csv"),
        (("SMR_1", "SMR_2"), "base_1", "SMR_*.csv"),
    ],
)
def test_a_glob_finds_no_file_of_another_entry(
    tmp_path: Path, names: tuple[str, ...], other: str, path: str | list[str]
) -> None:
    for name in names:
        (tmp_path / f"{name}.csv").write_text("target,x_mm,y_mm,z_mm\nA,1,2,3\nB,4,5,6\nC,7,8,10\n")
    (tmp_path / f"{other}.csv").write_text("who,when\nAnn,today\n")
    init(tmp_path)
    assert written(tmp_path)["files"]["points"]["path"] == path


def test_entries_of_loads_of_one_file_each_are_runs_of_their_own(tmp_path: Path) -> None:
    for name in ("cell1", "cell2", "cell2_check"):
        (tmp_path / f"{name}.csv").write_text("v1,v2,fx,fy\n1,2,0,0\n2,3,10,0\n".replace("v", "sensor_v"))
    (tmp_path / "loads.csv").write_text("Fx,Fy,Fz,known_Fx,known_Fy,known_Fz\n1,2,3,4,5,6\n")
    (tmp_path / "other.csv").write_text("Time (s),Fx (N),Fy (N),Mz (Nmm)\n1,2,3,4\n")
    init(tmp_path)
    entries = written(tmp_path)["files"]["signals"]
    assert len(entries) > 1
    runs = [entry["constants"]["run"] for entry in entries if "run" in entry.get("constants", {})]
    assert len(set(runs)) == len(runs) > 1, entries


def test_known_points_next_to_rays_are_no_survey_of_a_body(tmp_path: Path) -> None:
    rows = "".join(f"{k},{100 * k},{k * k},{7 * k % 5},0.01,0.01,0.01\n" for k in range(1, 9))
    heading = "point,x_mm,y_mm,z_mm,sigma_x_mm,sigma_y_mm,sigma_z_mm\n"
    (tmp_path / "known_points.csv").write_text(heading + rows)
    CliRunner().invoke(app, ["init", str(tmp_path), "--no-ask"])
    text = (tmp_path / "campaign.toml").read_text()
    assert "files.targets" not in text
