"""The real stages on the sample campaign read exactly the inputs that they declare."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from PIL import Image
from typer.testing import CliRunner, Result

from tests.blind.generator.arms import draw
from tests.blind.generator.arms import write as write_arm
from tests.blind.generator.axis import AxisLayout, record, write
from tests.blind.generator.schedule import random_moves
from tests.broken.good import axis
from tests.cut_telescope import cut_telescope
from tests.ignored_causes import search_only
from tests.photographs.ray_folder import write_rays
from tests.photographs.rays import Shooting, draw_rays
from tests.sensor_campaign import campaign_toml, measured, write_campaign
from tests.tolerance import assert_close
from truing.pipeline import campaign_run
from truing.pipeline.campaign_folder import SettingsView, open_campaign
from truing.pipeline.campaign_run import PROJECT, CampaignRun, open_run
from truing.pipeline.command_line import app
from truing.pipeline.console import RunConsole
from truing.pipeline.freshness import Freshness
from truing.pipeline.problems import ExitCode
from truing.pipeline.run_campaign import RunOptions, StageSelection, run_campaign
from truing.pipeline.stage_order import ORDER, makers, stage_module
from truing.schemas.artifacts import ARTIFACTS

BODIES = """[campaign]
name = "bodies"
kind = "photogrammetry"
drives = ["elevation_deg"]
[noise]
point_mm = 0.01
[bodies]
reference = "frame"
"""

PLATES = """
[measurement]
frame = "campaign"
up = [0.0, 0.0, 1.0]
[mechanism.platform]
thickness_mm = 20.0
rigid_radius_mm = 5.0
youngs_gpa = 70.0
poisson = 0.3
density_kg_m3 = 2700.0
"""
# Notation and instrument of simulated arms.
ARMS = (("urdf", "points-campaign"), ("standard", "points-series"), ("screws", "poses"))
SECOND = """
[diagnosis]
judge_on = "../second"
"""

POSES = """[campaign]
name = "poses"
kind = "photogrammetry"
drives = ["elevation_deg"]
[noise]
displacement_mm = 0.001
rotation_rad = 1e-5
[poses]
euler = "XYZ"
[measurement]
frame = "campaign"
"""

DISPLACEMENT = """[campaign]
name = "bench"
kind = "interferometer"
[noise]
displacement_mm = 0.001
rotation_rad = 1e-6
"""


def bodies_campaign(folder: Path) -> None:
    """Two bodies of no mechanism in six poses, one of which bends with the elevation."""
    folder.mkdir()
    (folder / "campaign.toml").write_text(BODIES)
    targets = [(0, 0, 0), (100, 0, 5), (0, 100, 10), (100, 100, 0), (50, 20, 30), (20, 60, 50)]
    bodies = ("frame", "dish")
    survey = [f"{b},{b[0]}{k},{x},{y},{z}," for b in bodies for k, (x, y, z) in enumerate(targets)]
    (folder / "targets.csv").write_text("\n".join(["body,target,x_mm,y_mm,z_mm,leg", *survey]) + "\n")
    rows, settings = ["pose,body,target,x_mm,y_mm,z_mm"], ["pose,role,time_s,elevation_deg"]
    for pose in range(8):
        settings.append(f"{pose},{'reference' if pose == 0 else 'calibration'},{10 * pose},{5.0 * pose}")
        for body in bodies:
            for k, (x, y, z) in enumerate(targets):
                bend = 0.002 * pose * x * y / 1e4 if body == "dish" else 0.0
                noise = 0.01 * (((7 * pose + 13 * k + len(body)) % 11) / 5 - 1)
                rows.append(f"{pose},{body},{body[0]}{k},{x + noise},{y - noise},{z + bend + noise / 2}")
    (folder / "points.csv").write_text("\n".join(rows) + "\n")
    (folder / "configurations.csv").write_text("\n".join(settings) + "\n")


def poses_campaign(folder: Path) -> None:
    """Poses of one body, turns as Euler angles: three elevations, each driven to twice."""
    folder.mkdir()
    (folder / "campaign.toml").write_text(POSES)
    rows = ["pose,body,x_mm,y_mm,z_mm,euler_a_deg,euler_b_deg,euler_c_deg"]
    settings = ["pose,role,time_s,elevation_deg"]
    for pose in range(6):
        elevation, again = 10.0 * (pose % 3), pose // 3
        rows.append(f"{pose},dish,{elevation + 0.001 * again},{-0.001 * again},0,{elevation},{0.001 * again},0")
        settings.append(f"{pose},calibration,{10 * pose},{elevation}")
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    (folder / "configurations.csv").write_text("\n".join(settings) + "\n")


BEAMS = """
[interferometer.beams]
dz = { direction = [0.0, 0.0, 2.0] }
"""


def displacement_campaign(folder: Path) -> None:
    """Six-component displacement under loads along each axis."""
    folder.mkdir()
    (folder / "campaign.toml").write_text(DISPLACEMENT)
    loads = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
    rows = [",".join(["run", "step", "time_s", *loads, "dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad"])]
    for run in range(6):
        for step in range(6):
            load = [100.0 * step if axis == run else 0.0 for axis in range(6)]
            response = [1e-4 * value + 1e-4 * ((step + k) % 3 - 1) for k, value in enumerate(load[:3])]
            turns = [1e-6 * value + 1e-7 * ((step + k) % 3 - 1) for k, value in enumerate(load[3:])]
            rows.append(",".join(map(str, [run, step, 60 * (6 * run + step), *load, *response, *turns])))
    (folder / "displacement.csv").write_text("\n".join(rows) + "\n")


def rays_campaign(folder: Path) -> None:
    """A machine in two poses, photographed from ten places each: rays, a camera, scale bars."""
    moves = random_moves(2, 0, np.random.default_rng(3))
    write_rays(draw_rays(Shooting(), moves, [], [], np.random.default_rng(1)), folder, seed=1)


def pictures_campaign(folder: Path) -> None:
    """One photograph of nothing: what is asked is what the stage reads of the settings."""
    (folder / "images" / "1").mkdir(parents=True)
    (folder / "campaign.toml").write_text('[campaign]\nname = "pictures"\nkind = "photogrammetry"\n')
    Image.fromarray(np.full((120, 160), 128, np.uint8)).save(folder / "images" / "1" / "a.png")


def driven_campaign(folder: Path, kind: str) -> None:
    """An axis sent to and fro, with two encoders and an instrument next to it."""
    sweep = np.linspace(-80.0, 80.0, 10)
    noise = {"command": 1e-3, "motor": 3e-4, "load": 1e-3, "measured": 1e-3}
    channels, command = ("motor", "load", "measured"), np.concatenate([sweep, sweep[::-1]] * 2)
    layout = AxisLayout(kind, "motor", channels, command, noise, 26, np.arange(40) % 5 == 3)
    write(record(layout, (), np.random.default_rng(5)), folder)


@pytest.fixture(scope="module")
def run_once(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, CampaignRun], dict[str, set[str]]]:
    """Runs of the sample campaign and small ones of other kinds, and which sections each stage read in them."""
    folder = tmp_path_factory.mktemp("sample")
    cut_telescope(folder / "telescope")
    bodies_campaign(folder / "bodies")
    displacement_campaign(folder / "bench")
    rays_campaign(folder / "rays")
    for name, lacking in (("barless", ["scale_bars"]), ("scaleless", ["scale_bars", "targets"])):
        rays_campaign(folder / name)
        for table in lacking:
            (folder / name / f"{table}.csv").unlink()
    pictures_campaign(folder / "pictures")
    poses_campaign(folder / "poses")
    axis(folder / "axis")
    driven_campaign(folder / "turntable", "rotary")
    driven_campaign(folder / "slide", "linear")
    write_campaign(folder / "sensor", *measured(np.random.default_rng(1)), campaign_toml(more=BEAMS + SECOND))
    write_campaign(folder / "second", *measured(np.random.default_rng(2)), campaign_toml(more=BEAMS))
    write_campaign(folder / "plated", *measured(np.random.default_rng(3)), campaign_toml(more=BEAMS + PLATES))
    for number, (notation, instrument) in enumerate(ARMS):
        arm = draw(number, notation=notation, instrument=instrument, causes=(), poses=20)
        search_only(write_arm(arm, folder / f"arm-{notation}"))
    views: dict[str, list[SettingsView]] = {}

    with pytest.MonkeyPatch.context() as patch:
        original = CampaignRun.outcome

        def outcome(self: CampaignRun, stage: Any, progress: Any) -> Any:
            def view(settings: Any, declared: tuple[str, ...]) -> SettingsView:
                views.setdefault(stage.name, []).append(SettingsView(settings, declared))
                return views[stage.name][-1]

            patch.setattr(campaign_run, "SettingsView", view)
            return original(self, stage, progress)

        patch.setattr(CampaignRun, "outcome", outcome)
        runs = {}
        parts = [("bodies", "deformation"), ("bodies", "qa"), ("bodies", "diagnose"), ("bench", "deformation")]
        parts += [("rays", "pose"), ("barless", "bundle"), ("scaleless", "bundle"), ("pictures", "images")]
        parts += [("poses", "calibrate"), ("axis", "deformation")]
        parts += [("sensor", "qa"), ("sensor", "uncertainty"), ("sensor", "transfer")]
        parts += [(name, stage) for name in ("turntable", "slide") for stage in ("deformation", "diagnose")]
        parts += [("plated", "report")]
        parts += [(f"arm-{notation}", "diagnose") for notation, _ in ARMS]
        for name, only in (("telescope", None), *parts):
            out = folder / "runs" / name
            code = run_campaign(
                open_campaign(folder / name), out, RunOptions(StageSelection(only=only)), RunConsole(quiet=True)
            )
            assert code in (ExitCode.DONE, ExitCode.FAILED_CHECK), name
            runs[name] = open_run(open_campaign(folder / name), out)
    return runs, {name: set().union(*(view.sections_read for view in made)) for name, made in views.items()}


def test_every_stage_reads_exactly_the_sections_it_declares(run_once: Any) -> None:
    _, read = run_once
    declared = {name: set(stage_module(name).DECLARATION.settings) for names in ORDER.values() for name in names}
    assert {n: (read[n] - declared[n], declared[n] - read[n]) for n in declared if read[n] != declared[n]} == {}


def test_every_artifact_of_a_kind_of_campaign_is_declared() -> None:
    for names in ORDER.values():
        assert set(makers(tuple(stage_module(name).DECLARATION for name in names))) <= set(ARTIFACTS)


def test_every_artifact_carries_the_metadata_of_the_contract(run_once: Any) -> None:
    runs, _ = run_once
    paths = list(runs["telescope"].folder.glob("*.parquet"))
    assert len(paths) >= 10
    for path in paths:
        carried = pq.read_schema(path).metadata
        keys = ("schema", "schema_version", "units", "stage", "digest", "software_version", "campaign")
        assert all(f"truing.{key}".encode() in carried for key in keys)
        assert carried[b"truing.campaign"] == b"telescope"


@pytest.mark.parametrize(
    ("old", "new", "section"),
    [
        ("point_mm = 0.005", "point_mm = 0.006", "noise.point_mm"),
        ("actuator_mm = 0.001", "actuator_mm = 0.002", "noise.actuator_mm"),
        ("u = 0.002", "u = 0.003", "mechanism.tolerance"),
        ("x_mm = 1.0", "x_mm = 1.5", "workspace"),
    ],
)
def test_a_changed_setting_makes_stale_who_declares_it(
    run_once: Any, old: str, new: str, section: str, tmp_path: Path
) -> None:
    runs, _ = run_once
    finished = runs["telescope"]
    shutil.copytree(finished.campaign.folder, tmp_path / "telescope")
    file = tmp_path / "telescope" / "campaign.toml"
    assert file.read_text().count(old) == 1
    file.write_text(file.read_text().replace(old, new))
    changed = open_run(open_campaign(tmp_path / "telescope"), finished.folder)
    own = {stage.name for stage, standing in changed.statuses() if section in standing.why}
    assert own == {stage.name for stage in changed.order if _declares(stage.settings, section)}


def _declares(settings: tuple[str, ...], section: str) -> bool:
    return any(section == setting or section.startswith(f"{setting}.") for setting in settings)


def test_every_process_leaves_the_same_bytes(run_once: Any, tmp_path: Path) -> None:
    """Neither the order of sets, nor clocks, nor places show in an artifact."""
    campaign = str(run_once[0]["telescope"].campaign.folder)
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(PROJECT)}
        words = ["run", campaign, "--only", "deformation", "--out", str(tmp_path / seed), "--quiet"]
        subprocess.run([sys.executable, "-m", "pipeline", *words], check=True, env=environment)
    first, second = ({path.name: path.read_bytes() for path in (tmp_path / seed).glob("*.parquet")} for seed in "12")
    assert len(first) >= 8
    assert [name for name in first if first[name] != second[name]] == []


def predicted(run: CampaignRun, *options: str) -> Result:
    words = [str(run.folder / "model.toml"), str(run.campaign.folder / "configurations.csv"), *options]
    return CliRunner().invoke(app, ["predict", *words])


def test_predict_says_where_the_platform_is_in_every_pose(run_once: Any, tmp_path: Path) -> None:
    run = run_once[0]["telescope"]
    assert predicted(run, "--out", str(tmp_path / "poses.parquet")).exit_code == 0
    table = pq.read_table(tmp_path / "poses.parquet")
    assert tuple(table.schema.names) == ARTIFACTS["poses"].columns
    assert table.schema.metadata[b"truing.campaign"] == b"telescope"
    assert table["pose"].to_pylist() == [*range(7), 41, 42]
    measured = pq.read_table(run.folder / "poses.parquet").filter(
        (pc.field("body") == "platform") & pc.field("default") & pc.field("pose").isin(table["pose"])
    )
    # The sample's platform moves by millimetres; a tenth of one is far beyond noise and any deformation.
    assert_close(table["pz_mm"], measured.sort_by("pose")["pz_mm"], atol=0.1, what="pz_mm")


def test_calibrate_speaks_of_the_extended_model_too(run_once: Any) -> None:
    folder = run_once[0]["telescope"].folder
    for name in ("calibration", "correlations", "accuracy", "model_choice", "requirements"):
        models = pq.read_table(folder / f"{name}.parquet", columns=["model"])["model"].to_pylist()
        assert "extended" in models, name
    reported = pq.read_table(folder / "accuracy.parquet").filter(pc.field("model") == "extended")
    assert sorted(reported["pose"].to_pylist()) == [*range(7), 41, 42]


def test_predict_writes_csv_on_stdout_and_to_a_file(run_once: Any, tmp_path: Path) -> None:
    run = run_once[0]["telescope"]
    shown = predicted(run)
    assert shown.exit_code == 0
    assert shown.stdout.splitlines()[0].startswith('"pose","body","parent","method"')
    assert len(shown.stdout.splitlines()) == 10
    assert predicted(run, "--out", str(tmp_path / "poses.csv")).exit_code == 0
    assert (tmp_path / "poses.csv").read_text() == shown.stdout


def test_predict_refuses_what_it_cannot_use(run_once: Any, tmp_path: Path) -> None:
    run = run_once[0]["telescope"]
    configurations = str(run.campaign.folder / "configurations.csv")
    for words, expected in (
        (["predict", configurations, configurations], "a model.toml that a run has written"),
        (["predict", str(run.folder / "model.toml"), "nowhere.csv"], "nowhere.csv: expected a file that exists"),
        (["predict", str(run.folder / "model.toml"), str(run.campaign.folder / "points.csv")], "column rho1_mm"),
        (["predict", str(run.folder / "model.toml"), configurations, "--out", "x.xls"], "ends in .csv or .parquet"),
    ):
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 2, done.output
        assert expected in done.stderr


def test_the_finished_run_is_fresh_in_another_place(run_once: Any, tmp_path: Path) -> None:
    runs, _ = run_once
    shutil.copytree(runs["telescope"].folder, tmp_path / "copy")
    shutil.rmtree(tmp_path / "copy" / ".truing")
    shutil.copytree(runs["telescope"].campaign.folder, tmp_path / "telescope")
    moved = open_run(open_campaign(tmp_path / "telescope"), tmp_path / "copy")
    assert {standing.state for _, standing in moved.statuses()} == {Freshness.FRESH}
