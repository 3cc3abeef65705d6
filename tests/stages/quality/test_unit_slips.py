"""A declared noise in a wrong unit is reported with the probable unit."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Targets
from tests.blind.generator.schedule import random_moves
from tests.sensor_campaign import SIGNAL_MV, campaign_toml, measured
from tests.sensor_campaign import write_campaign as write_bench
from tests.stages.line import run_line
from truing.pipeline.command_line import app
from truing.report.numbers import percent
from truing.stages.quality.unit_slips import unit_slip


@pytest.mark.parametrize(
    ("ratio", "declared", "unit", "meant"),
    [
        (1e-3, 5.0, "mm", "Did you mean 5 um, that is 0.005 mm?"),
        (1.2e3, 5e-6, "mm", "Did you mean 5e-06 m, that is 0.005 mm?"),
        (0.8e3, 5e-4, "um", "Did you mean 0.0005 mm, that is 0.5 um?"),
        (2.1e5, 1e-6, "arcsec", "Did you mean 1e-06 rad, that is 0.206 arcsec?"),
        (150.0, 1.0, "mm", "in the unit of its key?"),
        (50.0, 1.0, "mm", ""),
        (0.02, 1.0, "mm", ""),
        (float("nan"), 1.0, "mm", ""),
    ],
)
def test_a_slip_is_named_by_its_factor(ratio: float, declared: float, unit: str, meant: str) -> None:
    reported = unit_slip(ratio, declared, unit)
    assert reported.endswith(meant)
    assert bool(reported) == bool(meant)


def test_micrometres_written_for_millimetres_are_reported_by_qa_and_check(tmp_path) -> None:
    numbers = np.random.default_rng(3)
    made = write_campaign(
        draw_campaign(Layout(name="u", targets=Targets(per_leg=0)), random_moves(12, 0, numbers), [], numbers),
        tmp_path / "c",
        3,
    )
    text = (made / "campaign.toml").read_text(encoding="utf-8")
    declared = next(line for line in text.splitlines() if line.startswith("point_mm"))
    value = 1e3 * float(declared.split("=")[1])
    (made / "campaign.toml").write_text(text.replace(declared, f"point_mm = {value:g}"), encoding="utf-8")
    qa = run_line(made, "ingest", "qa")[0]["qa"].to_pandas().set_index(["check", "subject"])
    row = qa.loc[("noise", "base")]
    assert row["value"] < 0.01
    assert row["verdict"] == "fail"
    assert f"Did you mean {value:.3g} um" in row["message"]
    lines = CliRunner().invoke(app, ["check", str(made)]).output.splitlines()
    said = [line for line in lines if "Did you mean" in line]
    assert [line.split(":")[1].strip() for line in said] == ["base", "platform"]


@pytest.mark.parametrize(("value", "said"), [(0.191, "0.19 %"), (0.0, "0 %"), (99.7, "100 %"), (110.4, "110 %")])
def test_percentages_have_no_power_of_ten(value: float, said: str) -> None:
    assert percent(value) == said


@pytest.mark.parametrize(
    ("factor", "verdict", "meant"),
    [(1.0, "pass", ""), (1e3, "warn", "Did you mean 10 uV, that is 0.01 mV?"), (1e-3, "warn", "Did you mean 1e-05 V,")],
)
def test_a_noise_of_signals_in_another_unit_is_reported_by_qa_and_check(tmp_path, factor, verdict, meant) -> None:
    _, signals = measured(np.random.default_rng(3))
    declared = f"signal_mv = {SIGNAL_MV}"
    toml = campaign_toml().replace(declared, f"signal_mv = {SIGNAL_MV * factor:.6f}")
    write_bench(tmp_path / "c", None, signals, toml)
    qa = run_line(tmp_path / "c", "ingest", "qa")[0]["qa"].to_pandas().set_index(["check", "subject"])
    row = qa.loc[("noise", "signals")]
    assert row["verdict"] == verdict
    assert 0.5 < row["value"] * factor < 2.0
    assert meant in row["message"]
    lines = CliRunner().invoke(app, ["check", str(tmp_path / "c")]).output.splitlines()
    assert sum("Did you mean" in line for line in lines) == bool(meant)


def test_two_bodies_declared_as_one_are_asked_for(tmp_path) -> None:
    rng = np.random.default_rng(4)
    survey, halves = rng.uniform(-200.0, 200.0, (12, 3)), np.arange(12) < 6
    lines = ["pose,body,target,x_mm,y_mm,z_mm"]
    for pose in range(15):
        moved = survey + np.where(halves[:, None], *rng.uniform(-5.0, 5.0, (2, 3))) + rng.normal(0.0, 0.005, (12, 3))
        lines += [f"{pose},body,T{k},{x:.4f},{y:.4f},{z:.4f}" for k, (x, y, z) in enumerate(moved)]
    (tmp_path / "points.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = '[campaign]\nname = "one"\nkind = "photogrammetry"\n[noise]\npoint_mm = 0.005\n'
    (tmp_path / "campaign.toml").write_text(text, encoding="utf-8")
    found = run_line(tmp_path, "ingest", "qa")[0]["qa"].to_pandas().set_index("check").loc["noise-size"]
    assert found["verdict"] == "fail"
    assert found["message"].endswith("Or do these points belong to several bodies?")
