"""The pose stage of a loaded platform: correct uncertainty, rejected gross errors, and no invented components."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.blind.generator.sensor.layout import CHANNELS, DataFaults, Programme
from tests.blind.generator.sensor.recording import ZeroDrift
from tests.stages.benches import READING_SI, Bench, bench, case_errors, layout
from tests.stages.line import run_line
from truing.report.numbers import gross_errors

POSE = ("ingest", "pose")
COMPONENTS = ["dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad"]


def _mean_square(errors: np.ndarray) -> float:
    return float(np.nanmean(errors**2))


def test_displacements_are_the_true_ones_within_their_covariance(tmp_path):
    """Two campaigns of 36 runs, one channel in each. The zeros and drifts of its runs are common to many errors:
    about half of their 654 squares a campaign are independent."""
    made = [bench(tmp_path / str(seed), layout(), seed, stages=POSE) for seed in range(2)]
    errors = np.concatenate([case_errors(one) for one in made])
    assert np.isfinite(errors).all()
    assert abs(_mean_square(errors) - 1.0) < 4 * np.sqrt(2 / (2 * 327))
    assert np.abs(errors).max() < 5.0
    cases = made[0].frame("displacement")
    assert len(cases) == 109
    assert cases[COMPONENTS].notna().all(axis=None)
    assert "109 of 109 load cases" in made[0].outcomes["pose"].figure


def test_ways_up_and_back_are_cases_of_their_own(tmp_path):
    cases = bench(tmp_path / "c", layout("all"), 1, stages=POSE).frame("displacement")
    ways = cases.groupby("fz_n")["branch"].agg(list)
    assert ways[7000.0] == ["loading", "unloading"]
    assert ways[9000.0] == ["loading"]
    assert (cases.loc[(cases.filter(regex="^[fm][xyz]_") == 0.0).all(axis=1), "branch"] == "unloaded").all()


@pytest.fixture(scope="module")
def faulty(tmp_path_factory) -> list[Bench]:
    """Three campaigns with steps lost, two readings in a hundred gross, and a channel that was never measured."""
    faults = DataFaults(missing_share=0.05, missing_steps=0.03, gross_share=0.02, never=("rz",))
    folder = tmp_path_factory.mktemp("faulty")
    return [bench(folder / str(seed), layout(faults=faults), seed, stages=POSE) for seed in range(3)]


def test_gross_errors_are_kept_out_and_counted(faulty):
    true, found = set(), set()
    for number, one in enumerate(faulty):
        drawn, left = one.drawn, one.frame("reading_residuals")
        steps, channels = np.nonzero(drawn.gross & drawn.is_observed)
        schedule = drawn.schedule
        true |= {(number, schedule.run[n], schedule.step[n], CHANNELS[k]) for n, k in zip(steps, channels, strict=True)}
        out = left[left["rejected"]]
        found |= {(number, r.run, r.step, r.channel) for r in out.itertuples()}
        assert out["reason"].str.startswith("gross error").all()
        assert (out["weight"] == 0.0).all()
        assert gross_errors(len(out), "reading") in one.outcomes["pose"].left_out
        assert one.frame("displacement")["n_rejected"].sum() == len(out)
    assert len(true) > 20
    assert not found - true
    assert len(true - found) <= 0.05 * len(true)
    assert abs(_mean_square(np.concatenate([case_errors(one) for one in faulty])) - 1.0) < 0.2


def test_a_component_without_readings_has_no_value_and_no_covariance(faulty):
    cases = faulty[0].frame("displacement")
    assert cases["rz_rad"].isna().all()
    assert cases["cov_5_5"].isna().all()
    assert cases["cov_0_5"].isna().all()
    assert cases["dx_mm"].notna().mean() > 0.9
    assert "never measured: rz" in faulty[0].outcomes["pose"].figure


def test_own_channels_leave_the_other_components_of_a_load_open(tmp_path):
    made = bench(tmp_path / "c", layout("own"), 2, stages=POSE)
    cases = made.frame("displacement")
    under_z = cases[cases["fz_n"] != 0.0]
    assert under_z["dz_mm"].notna().all()
    assert under_z[[name for name in COMPONENTS if name != "dz_mm"]].isna().all(axis=None)
    assert "fz dx dy rx ry rz" in made.outcomes["pose"].figure


def test_drift_is_reported_per_run_and_taken_out(tmp_path):
    rate = 20e-6 / 3600.0
    drift = ZeroDrift(channel=CHANNELS.index("dz"), rate=rate)
    made = bench(tmp_path / "c", layout(), 3, [drift], stages=POSE)
    terms = made.frame("run_terms")
    found = terms[(terms["term"] == "drift") & (terms["channel"] == "dz")]
    z = (found["value"] - rate * 3600.0 / READING_SI[2]) / found["sigma"]
    assert len(found) == 6
    assert np.abs(z).max() < 4.0
    assert (found["p_value"] < 1e-6).all()
    assert np.nanmax(np.abs(case_errors(made))) < 5.0


def test_noise_that_nobody_declared_comes_from_the_readings(tmp_path):
    made = bench(tmp_path / "c", layout("all"), 4, stages=POSE)
    text = (tmp_path / "c" / "campaign.toml").read_text(encoding="utf-8")
    kept = [line for line in text.splitlines() if not line.startswith(("linear_um", "angular_arcsec"))]
    (tmp_path / "c" / "campaign.toml").write_text("\n".join(kept), encoding="utf-8")
    tables, _ = run_line(tmp_path / "c", *POSE)
    left = tables["reading_residuals"].to_pandas()
    found = left.groupby("channel")["sigma"].first().reindex(CHANNELS) * READING_SI
    assert np.abs(found / made.drawn.layout.noise.channels - 1.0).max() < 0.35  # from 14 x 6 spare readings each


def test_several_loads_at_once_are_cases_too(tmp_path):
    made = bench(tmp_path / "c", replace(layout(), programme=Programme(together=4)), 5, stages=POSE)
    assert abs(_mean_square(case_errors(made)) - 1.0) < 0.5
    assert made.frame("displacement")[COMPONENTS].notna().all(axis=None)


def test_coordinates_are_counted_from_the_unloaded_reading_that_a_run_begins_with(tmp_path):
    """Another system's six components need not begin at zero, nor all runs at the same place."""
    programme = Programme(channels="all", repeats=2)
    made = bench(tmp_path / "c", layout(programme=programme, written_as="displacement"), 6, stages=POSE)
    table = pd.read_csv(tmp_path / "c" / "displacement.csv")
    shifted = table.assign(dz_mm=table["dz_mm"] + 3.0 + 0.5 * table["run"])
    shifted.to_csv(tmp_path / "c" / "displacement.csv", index=False)
    moved = replace(made, tables=run_line(tmp_path / "c", *POSE)[0])
    assert abs(_mean_square(case_errors(moved)) - 1.0) < 0.5
    zeros = moved.frame("run_terms").query("term == 'zero' and channel == 'dz'")
    assert np.abs(zeros["value"] - 1e3 * (3.0 + 0.5 * zeros["run"])).max() < 3.0
