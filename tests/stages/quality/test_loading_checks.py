"""Checks of a loading campaign: silent on a good one, and each defect is named with its place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.sensor_campaign import LARGEST, NOISE, READING, campaign_toml, measured, sensor, write_campaign
from tests.sentences import assert_says
from tests.stages.line import run_line
from tests.tolerance import assert_between, assert_close
from truing.estimation.interferometry.flexible_response import ChannelFit
from truing.quality.loading import ChannelView
from truing.report.measured_loads import measured_loads
from truing.schemas.load_checks import OF_LOADS
from truing.stages.quality.check import FAIL
from truing.stages.quality.reading_checks import noise

Tables = tuple[pd.DataFrame, pd.DataFrame]
Change = Callable[[pd.DataFrame, pd.DataFrame], Tables | None]


def quality_of(
    folder: Path, change: Change | None = None, seed: int = 3, toml: str | None = None, **how: object
) -> pd.DataFrame:
    readings, signals = measured(np.random.default_rng(seed), **how)  # type: ignore[arg-type]
    changed = None if change is None else change(readings, signals)
    write_campaign(folder / "c", *(changed or (readings, signals)), campaign_toml() if toml is None else toml)
    return run_line(folder / "c", "ingest", "qa")[0]["qa"].to_pandas()


def messages(qa: pd.DataFrame, verdict: str) -> dict[str, str]:
    """Messages of the rows with a verdict, by check and subject."""
    rows = qa[qa["verdict"] == verdict]
    return {f"{r.check} {r.subject}".strip(): r.message for r in rows.itertuples()}


@pytest.mark.parametrize("own_channel", [False, True])
def test_a_good_campaign_passes(tmp_path, own_channel):
    for seed in range(2):
        (tmp_path / str(seed)).mkdir()
        qa = quality_of(tmp_path / str(seed), seed=seed, own_channel=own_channel, repeats=2)
        assert not messages(qa, "fail")
        assert not messages(qa, "warn")
        assert set(qa["check"]) <= set(OF_LOADS)
        assert (qa["verdict"] == "pass").sum() > 40


@pytest.mark.parametrize("with_times", [False, True])
def test_without_times_no_pause_and_no_drift_is_assessed_and_no_span_is_reported(tmp_path, with_times):
    _, signals = measured(np.random.default_rng(3))
    times = {"time_s": 60.0 * np.arange(len(signals))} if with_times else {}
    write_campaign(tmp_path / "c", None, signals.assign(**times), campaign_toml())
    tables = run_line(tmp_path / "c", "ingest", "qa")[0]
    qa = tables["qa"].to_pandas().set_index("check")
    assert qa.loc["time-gaps", "verdict"] == ("pass" if with_times else "not evaluated")
    lead = measured_loads({"signals": tables["signals"].to_pandas()}).lead
    assert (" over " in lead) == with_times
    assert ("without times" in lead) != with_times


def test_readings_whose_times_only_count_give_no_drift_unless_one_is_seen(tmp_path):
    def counted(readings, signals):
        readings["time_s"] = readings.groupby("run")["step"].transform(lambda step: step - step.min()).astype(float)

    drift = quality_of(tmp_path, counted).set_index("check").loc["drift"]
    assert (drift["verdict"] == "not evaluated").all()


def test_a_correction_that_is_less_well_known_than_its_channel_reads_is_reported(tmp_path):
    """Errors of 0.2 K at both ends of 300 mm of steel are worth 0.98 um, of 30 mm a tenth of that; noise 0.5 um."""
    growth = "expansion_per_k = 11.5e-6"
    more = f"[interferometer.material]\ndz = {{ length_mm = 300.0, {growth} }}\ndx = {{ length_mm = 30.0, {growth} }}\n"
    toml = campaign_toml(more=f"{more}[interferometer.surroundings_sigma]\nmaterial_temperature_c = 0.2\n")
    warm = 20.0 + 0.1 * np.sin(np.arange(102))

    def measured_warm(readings, signals):
        of_step = {(r.run, r.step): n for n, r in enumerate(readings[["run", "step"]].drop_duplicates().itertuples())}
        places = [of_step[key] for key in zip(readings["run"], readings["step"], strict=True)]
        return readings.assign(material_temperature_c=warm[places]), signals

    qa = quality_of(tmp_path, measured_warm, toml=toml)
    rows = qa[qa["check"] == "corrections"].set_index("subject")
    assert dict(rows["verdict"]) == {"channel dz material": "warn", "channel dx material": "pass"}
    assert_close(rows["value"], [0.0976, 0.976], atol=1e-3)
    assert "0.98 um" in rows.loc["channel dz material", "message"]


def at(table: pd.DataFrame, run: int, **where: object) -> pd.Series:
    mask = table["run"] == run
    for name, value in where.items():
        mask &= table[name] == value
    return mask


def in_millimetres(readings, signals):
    readings.loc[at(readings, 3, channel="dz"), "reading"] *= 1e-3


def load_turned_round(readings, signals):
    readings.loc[readings["run"] == 4, "reading"] *= -1.0


def labels_exchanged(readings, signals):
    own = readings["run"] == 1
    readings.loc[own, "channel"] = readings.loc[own, "channel"].replace({"dx": "dy", "dy": "dx"})


def not_set_to_zero(readings, signals):
    off = np.random.default_rng(4).normal(0.0, 3.0, int(readings["run"].max()) + 1)
    readings["reading"] += np.where(readings["channel"] == "dz", off[readings["run"]], 0.0)


def begun_elsewhere(readings, signals):
    readings.loc[at(readings, 5, channel="rx"), "reading"] += 10.0


def step_lost(readings, signals):
    return readings[~at(readings, 2, step=7)], signals[~at(signals, 2, step=7)]


def step_not_read(readings, signals):
    return readings[~at(readings, 2, step=7)], signals


def run_ended_early(readings, signals):
    late = [(table["run"] == 5) & (table["step"] > 12) for table in (readings, signals)]
    return readings[~late[0]], signals[~late[1]]


def readings_lost(readings, signals):
    return readings[(readings["channel"] != "ry") | (readings["step"] % 2 == 0)], signals


def noisy(readings, signals):
    rows = readings["channel"] == "dx"
    readings.loc[rows, "reading"] += np.random.default_rng(1).normal(0.0, 1.5, rows.sum())


def jumped(readings, signals):
    readings.loc[at(readings, 2, channel="rx") & (readings["step"] >= 6), "reading"] += 6.0


def walked(readings, signals):
    rows = at(readings, 6, channel="dy")
    readings.loc[rows, "reading"] += 0.6 * readings.loc[rows, "step"]


def gross(readings, signals):
    rows = readings.index[readings["channel"] == "rz"]
    readings.loc[rows[3::14], "reading"] += 40.0


def in_kelvin(readings, signals):
    readings["air_temperature_c"] = 293.15


def humidity_as_fraction(readings, signals):
    readings["relative_humidity_pct"] = 0.48


def warming(readings, signals):
    readings["air_temperature_c"] = 19.0 + 0.2 * readings["step"]
    readings["air_pressure_hpa"] = 1000.0


def cut(readings, signals):
    limit = 0.4 * signals["v2_mv"].max()
    signals["v2_mv"] = signals["v2_mv"].clip(upper=limit)


def repeated_channel(readings, signals):
    signals["v5_mv"] = signals["v1_mv"]


def dead_channel(readings, signals):
    signals["v6_mv"] = 0.0


def rows_exchanged(readings, signals):
    first, second = signals.index[at(signals, 2, step=4) | at(signals, 2, step=12)]
    loads = signals.loc[[first, second], "load"].to_numpy()
    signals.loc[[first, second], "load"] = loads[::-1]
    return None, signals


def never_about_z(readings, signals):
    return readings[readings["run"] != 6], signals[signals["run"] != 6]


def moment_with_force(readings, signals):
    wrench = np.zeros((len(signals), 6))
    wrench[np.arange(len(signals)), signals["run"] - 1] = signals["load"]
    wrench[:, 4] = 0.02 * wrench[:, 0]
    names = ["fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm"]
    return None, pd.concat([signals.drop(columns=["load_axis", "load"]), pd.DataFrame(wrench, columns=names)], axis=1)


@pytest.mark.parametrize(
    ("change", "verdict", "row", "message"),
    [
        (in_millimetres, "fail", "units run 3 dz", "reads 0.001 times the expected value; is its unit"),
        (load_turned_round, "fail", "signs run 4 dy rx", "run 4: dy rx with the opposite sign"),
        (labels_exchanged, "fail", "channels-exchanged run 1 dx dy", "dx reads the response expected of dy and dy"),
        (not_set_to_zero, "warn", "run-zeros channel dz", "from zero; noise of two readings makes 0.7"),
        (begun_elsewhere, "warn", "run-zeros channel rx", "Largest: run 5 +9."),
        (step_lost, "warn", "steps-missing", "1 step is missing: run 2 near step 6"),
        (step_not_read, "warn", "steps-missing", "1 step is missing: run 2 step 7"),
        (run_ended_early, "warn", "runs-cut-short", "run 5"),
        (readings_lost, "fail", "completeness channel ry", "ry: 47.1 % of the readings are missing"),
        (noisy, "fail", "noise channel dx", "times the declared noise"),
        (jumped, "warn", "jumps run 2 rx", "rx jumps by +"),
        (walked, "warn", "drift channel dy", "um over run 6"),
        (walked, "warn", "zero-return channel dy", "the zero return after run 6 is +"),
        (gross, "warn", "gross-errors channel rz", "15 of 204 readings are gross errors (run 1 step 3"),
        (in_kelvin, "fail", "surroundings air temperature", "is the unit right?"),
        (humidity_as_fraction, "warn", "surroundings relative humidity", "if it is a fraction of 1 (48 %)"),
        (warming, "warn", "temperature-span air temperature", "within a run by 3.2 K at most"),
        (cut, "fail", "saturated signal v2", "samples are cut at "),
        (repeated_channel, "fail", "signals-independent", "V V^T is singular; only v1 + v5 is determined"),
        (dead_channel, "fail", "signals-independent", "V V^T is singular; v6 is unobservable"),
        (rows_exchanged, "fail", "exchanged-rows run 2 step 4 and run 2 step 12", "The loads (fy) of run 2 step 4"),
        (never_about_z, "warn", "loads-span", "mz never loaded: only 5 components can be calibrated"),
        (moment_with_force, "fail", "loads-span", "V V^T is singular: only fx + 0.02 my is determined"),
    ],
    ids=lambda value: value.__name__ if callable(value) else None,
)
def test_every_defect_is_found_and_reported_where_it_is(tmp_path, change, verdict, row, message):
    repeats = 2 if change in (noisy, jumped, gross) else 1  # one run per axis leaves little that nothing else explains
    found = messages(quality_of(tmp_path, change, repeats=repeats), verdict)
    assert row in found, found
    assert message in found[row]


def test_what_noise_makes_of_the_zeros_of_runs_is_no_limit(tmp_path):
    """Zeros scatter by noise, so that half of the channels would exceed it and yet pass."""
    quality = quality_of(tmp_path, noisy, repeats=2)
    zeros = quality[quality["check"] == "run-zeros"]
    assert len(zeros) == 6
    assert zeros["value"].notna().all()
    assert zeros["limit"].isna().all()


def test_wrong_steps_are_found_without_a_simulation(tmp_path):
    toml = campaign_toml().partition("[mechanism]")[0] + "[noise]\nlinear_um = 0.5\nangular_arcsec = 0.2\n"

    def change(readings, signals):
        readings.loc[at(readings, 8, channel="dz"), "reading"] *= 1e-3
        readings.loc[at(readings, 11, channel="rx"), "reading"] *= -1.0
        return readings, None

    failed = messages(quality_of(tmp_path, change, toml=toml, repeats=3), "fail")
    assert {"units run 8 dz", "signs run 11 rx"} <= set(failed)


def test_a_verdict_may_be_accepted_by_name(tmp_path):
    accept = '[[accept]]\ncheck = "units"\nsubject = "run 3 dz"\nby = "K"\nreason = "known"\n'
    readings, signals = measured(np.random.default_rng(3))
    in_millimetres(readings, signals)
    write_campaign(tmp_path / "c", readings, signals, campaign_toml(more=accept))
    tables, said = run_line(tmp_path / "c", "ingest", "qa")
    qa = tables["qa"].to_pandas().set_index(["check", "subject"])
    assert qa.loc[("units", "run 3 dz"), "accepted"] == "K: known"
    assert "units run 3 dz" not in said["qa"].failed_checks


def test_signals_alone_are_assessed_and_the_rest_is_reported_as_not_evaluated(tmp_path):
    def change(readings, signals):
        signals.loc[signals["run"] == 7, "load"] *= -1.0
        return None, signals

    qa = quality_of(tmp_path, change, repeats=3)
    assert list(messages(qa, "fail")) == ["signals-against-loads run 7", "signs run 7 v1 v2 v3 v4 v5 v6"]
    assert "no readings" in messages(qa, "not evaluated")["completeness"]
    assert "loads-span" in messages(qa, "pass")


def test_a_single_run_per_axis_does_not_confirm_signs_and_axes(tmp_path):
    """One run under each axis: no sign and no axis of a run is known by another."""

    def change(readings, signals):
        return None, signals

    qa = quality_of(tmp_path, change, repeats=1)
    assert_says(messages(qa, "not evaluated")["signs signals"], "another run", "same axis")
    assert_says(messages(qa, "pass")["exchanged-rows"], "whole runs", "cannot")
    (tmp_path / "2").mkdir()
    qa = quality_of(tmp_path / "2", change, repeats=2)
    assert_says(messages(qa, "pass")["signs signals"], "same sign", "runs")


def test_noise_at_the_bound_fails_as_rarely_as_stated():
    """At twice the declared noise, which is tolerated, a share of 5 % fails 5 % of campaigns; at the declared, none."""
    rng = np.random.default_rng(5)
    count, share, draws = 40, 0.05, 2000
    ones, none = np.ones(count), np.zeros(1)
    fit = ChannelFit(ones, ones, np.ones(count, bool), count, none, none, np.zeros(1, np.int64), none, np.ones(1))
    channel = ChannelView(0, np.arange(count), np.zeros(1, np.int64), np.zeros(count, np.int64), 1.0, fit)

    def failing(ratio: float) -> float:
        residuals = ratio * rng.normal(size=(draws, count))
        checks = (noise(replace(channel, fit=replace(fit, residual=residual)), share) for residual in residuals)
        return float(np.mean([check.verdict == FAIL for check in checks]))

    allowed = 3.0 * np.sqrt(share * (1 - share) / draws)
    assert abs(failing(2.0) - share) < allowed
    assert abs(failing(0.5) - share) < allowed
    assert failing(1.0) == 0.0


def test_a_programme_of_loads_that_repeats_worse_than_the_others_is_named(tmp_path):
    """Runs 7 and 8 load mx; one pooled number would hide that they alone do not come out again."""

    def worse(readings: pd.DataFrame, _: pd.DataFrame) -> None:
        own = readings["run"].isin([7, 8]) & (readings["channel"] == "dx")
        readings.loc[own, "reading"] += np.random.default_rng(5).normal(0.0, 2.5, int(own.sum()))

    qa = quality_of(tmp_path, worse, repeats=2)
    rows = qa[qa["check"] == "repeatability"].set_index("subject")
    row = rows.loc["channel dx"]
    assert row["verdict"] == "warn"
    assert_says(row["message"], "dx", "repeats", "run 7")
    assert_between(row["value"], 1.6, 8.0)
    assert set(rows.drop(index="channel dx")["verdict"]) == {"pass"}


@pytest.mark.parametrize(("of_products", "verdict"), [(True, "warn"), (False, "fail")])
def test_a_response_to_products_of_loads_is_no_noise(tmp_path, of_products, verdict):
    """Random loads along all axes at once: dx scatters by eight times its noise, or follows fy x fz."""
    rng = np.random.default_rng(5)
    share = rng.uniform(-1.0, 1.0, (96, 6))
    share[::16] = 0.0
    columns = ["fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm"]
    table = pd.DataFrame(share * LARGEST, columns=columns)
    table = table.assign(run=np.repeat(np.arange(1, 7), 16), step=np.tile(np.arange(16), 6))
    motion = sensor().displacement(share * LARGEST) * READING + NOISE * rng.normal(size=(96, 6))
    size = 8.0 * NOISE[0]
    motion[:, 0] += size * (3.0 * share[:, 1] * share[:, 2] if of_products else rng.normal(size=96))
    in_files = np.array([1e-3] * 3 + [np.pi / 180.0 / 3600.0] * 3)
    names = ["dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad"]
    table[names] = motion * in_files
    table["time_s"] = 60.0 * np.arange(96)
    write_campaign(tmp_path / "c", None, None, campaign_toml())
    table.to_csv(tmp_path / "c" / "displacement.csv", index=False)
    qa = run_line(tmp_path / "c", "ingest", "qa")[0]["qa"].to_pandas()
    assert "noise channel dx" in messages(qa, verdict)
