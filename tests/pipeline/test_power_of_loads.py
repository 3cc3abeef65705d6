"""`truing power` of a bench: planned load steps give the same result as measured ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from tests.blind.generator.sensor.campaign import draw_campaign
from tests.blind.generator.sensor.folder import write_campaign
from tests.blind.generator.sensor.layout import Layout, Programme, Tolerance
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.command_line import app
from truing.pipeline.power_command import PowerOptions, _plan

SIGNALS = [f"v{leg}_mv" for leg in range(1, 7)]
LAYOUT = Layout("planned", tolerance=Tolerance(stiffness=0.02), programme=Programme(axes=("fz", "mx")), signals=6)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = draw_campaign(LAYOUT, [], np.random.default_rng(3))
    folder = write_campaign(made, tmp_path_factory.mktemp("power") / "bench", 1)
    with (folder / "campaign.toml").open("a") as file:
        file.write("\n[signals]\nsensitivity_mv_per_n = 0.001\nsensitivity_tolerance = 0.05\n")
    return folder


@pytest.fixture
def planned(measured: Path, tmp_path: Path) -> Path:
    """The same campaign before anything was measured."""
    folder = tmp_path / "planned"
    folder.mkdir()
    (folder / "campaign.toml").write_text((measured / "campaign.toml").read_text())
    readings, signals = (pd.read_csv(measured / name) for name in ("interferometer.csv", "signals.csv"))
    readings.drop(columns="reading").to_csv(folder / "interferometer.csv", index=False)
    signals.assign(**dict.fromkeys(SIGNALS)).to_csv(folder / "signals.csv", index=False)
    return folder


def drawn(folder: Path) -> dict[str, pa.Table]:
    campaign = open_campaign(folder)
    return dict(_plan(campaign, campaign.validated(), PowerOptions()).drawn((), np.random.default_rng(7)))


def emptied(readings: pd.DataFrame) -> pd.DataFrame:
    return readings.assign(reading=None)


def without_channels(readings: pd.DataFrame) -> pd.DataFrame:
    return readings.drop(columns="channel").drop_duplicates(["run", "step"])


@pytest.mark.parametrize("written", [lambda readings: readings, emptied, without_channels])
def test_planned_and_measured_campaigns_are_drawn_alike(
    written: Callable[[pd.DataFrame], pd.DataFrame], measured: Path, planned: Path
) -> None:
    file = planned / "interferometer.csv"
    written(pd.read_csv(file)).to_csv(file, index=False)
    was, now = drawn(measured), drawn(planned)
    for name in ("readings", "signals"):
        pd.testing.assert_frame_equal(now[name].to_pandas(), was[name].to_pandas(), rtol=1e-9)


def test_a_plan_is_answered_and_left_as_it_is(planned: Path, tmp_path: Path) -> None:
    before = sorted(planned.iterdir())
    out = tmp_path / "made" / "power.csv"
    words = ["power", str(planned), "--draws", "0", "--causes", "load-eccentricity,creep", "--out", str(out)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert sorted(planned.iterdir()) == before
    reported = pd.read_csv(out)
    assert set(reported["cause"]) == {"load-eccentricity", "creep"}
    assert (reported["expected_80"] > 0).all()


def test_loads_are_chosen_that_show_a_wanted_cause_next_to_those_planned(planned: Path, tmp_path: Path) -> None:
    out = tmp_path / "loads.csv"
    words = ["design", str(planned), "--causes", "creep", "--out", str(out)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    output = " ".join(done.output.split())
    assert "creep load fz: To determine fraction (creep, load fz) more precisely, apply th" in output
    reported = pd.read_csv(out)
    assert set(reported["purpose"]) == {"creep: fraction", "creep load fz: fraction", "creep load mx: fraction"}
    # creep shows best where a load stays
    held = (
        reported[reported["purpose"] == "creep load fz: fraction"]
        .groupby("run")["fz_n"]
        .agg(lambda load: load.duplicated().sum())
    )
    assert held.max() >= 6
    refused = CliRunner().invoke(app, [*words[:3], "creeep"])
    assert refused.exit_code == 2
    assert "found 'creeep'" in " ".join(refused.output.split())


def _without(key: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        file = folder / "campaign.toml"
        lines = file.read_text().splitlines(keepends=True)
        file.write_text("".join(line for line in lines if not line.startswith(key)))

    return change


def _with_few_steps(folder: Path) -> None:
    (folder / "signals.csv").unlink()
    file = folder / "interferometer.csv"
    readings = pd.read_csv(file)
    readings[(readings["step"] < 5) & (readings["run"] == 1)].to_csv(file, index=False)


def _without_times(folder: Path) -> None:
    file = folder / "interferometer.csv"
    pd.read_csv(file).assign(time_s=None).to_csv(file, index=False)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (_without("angular_arcsec"), "noise.angular_arcsec: expected the standard deviation of channels rx, ry, rz"),
        (_without("sensitivity_mv"), "signals.sensitivity_mv_per_n: expected a number, to simulate the signals that"),
        (_without("signal_mv"), "noise.signal_mv: expected a number, to simulate the signals that signals.csv plans"),
        (_with_few_steps, "needs at least 6 load steps with readings, found 5"),
        (_without_times, "row 2, column time_s: found ''; expected a number in every row"),
    ],
)
def test_a_plan_that_cannot_be_drawn_says_why(change: Callable[[Path], None], expected: str, planned: Path) -> None:
    change(planned)
    done = CliRunner().invoke(app, ["power", str(planned), "--draws", "0"])
    assert done.exit_code == 2, done.output
    assert expected in " ".join(done.output.split())
