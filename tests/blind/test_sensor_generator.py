"""The generator of force-sensor campaigns obeys the physics and the campaign format."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.blind.generator.folder import truth_path
from tests.blind.generator.named_effect import as_record
from tests.blind.generator.sensor import effects as hidden
from tests.blind.generator.sensor import recording
from tests.blind.generator.sensor.campaign import Campaign, draw_campaign
from tests.blind.generator.sensor.effects import Effect
from tests.blind.generator.sensor.folder import write_campaign
from tests.blind.generator.sensor.force_sensor import LAYOUT, SEED, force_sensor_campaign, write_force_sensor
from tests.blind.generator.sensor.layout import ARCSEC, AXES, CHANNELS, Layout, Noise, Programme
from tests.blind.generator.sensor.machine import build, flawless
from tests.blind.generator.sensor.recording import across
from tests.blind.generator.sensor.schedule import unloading
from tests.tolerance import assert_close

PROJECT = Path(__file__).resolve().parents[2]
EXACT = Layout("exact", noise=Noise(exact=True), signals=6, programme=Programme(uneven=0.0))
FZ, DZ, DX, MY = AXES.index("fz"), 2, 0, AXES.index("my")

EFFECTS: tuple[Effect, ...] = (
    hidden.LoadEccentricity(FZ, (0.01, 0.0, 0.0)),
    hidden.LoadEccentricity(MY, (0.0, 0.02, 0.01)),
    hidden.LoadImbalance(FZ, (0.0,) * 6, (0.0, 0.0, 0.0, 0.0, 0.01, 0.0)),
    hidden.StiffnessScale(FZ, 0.05),
    hidden.StiffnessAsymmetry(FZ, 0.03),
    hidden.StiffnessNonlinear(MY, 0.02, along_only=True),
    hidden.Hysteresis(FZ, 0.02),
    hidden.JointClearance(FZ, 5e-6),
    hidden.Creep((FZ,), 0.02, 300.0),
    hidden.Creep(tuple(range(6)), 0.02, 300.0),
    recording.ZeroDrift(DZ, 2e-9),
    recording.ThermalDrift(DZ, 5e-6, 3e-6),
    recording.CosineError(DX, 0.02, across(DX, 0.4)),
    recording.AbbeOffset(DZ, (0.02, 0.03, 0.0)),
    recording.DeadPath(DX, 0.4),
    recording.FringeSlip(DZ, 3, False, 8, 9),
    recording.Crosstalk(2, 4, 0.05),
    recording.RowsExchanged(3, (4, 8)),
)


def draw(effects: Sequence[Effect] = (), layout: Layout = EXACT, seed: int = 7) -> Campaign:
    return draw_campaign(layout, effects, np.random.default_rng(seed))


PLAIN = draw()


def _difference(effect: Effect) -> np.ndarray:
    return draw([effect]).readings - PLAIN.readings


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.id)
def test_every_effect_shows_and_is_reported_in_the_truth(effect: Effect) -> None:
    changed = draw([effect])
    readings = np.abs(changed.readings - PLAIN.readings).max()
    signals = np.abs(changed.signals - PLAIN.signals).max()
    assert readings > 1e-8 or signals > 1e-3
    reported = as_record(effect)
    assert reported["cause"] == effect.id
    assert reported["parameters"]
    assert all(set(entry) == {"value", "unit"} for entry in reported["parameters"].values())


def test_an_offset_force_is_a_moment_and_a_moment_alone() -> None:
    changed = draw([hidden.LoadEccentricity(FZ, (0.01, -0.02, 0.0))])
    F = PLAIN.schedule.load[:, FZ]
    brought = changed.truth.wrench - PLAIN.truth.wrench
    assert_close(brought[:, 3:], F[:, None] * [-0.02, -0.01, 0.0], atol=1e-9, what="r x F of a force along z")
    assert not np.any(brought[:, :3]), "force"


def test_no_offset_explains_what_was_measured_along_z_and_units_that_share_otherwise_could() -> None:
    """Its effects are odd in the load; +428 and -207 um are not."""
    under_fz = PLAIN.schedule.load[:, FZ] != 0
    up, down = (PLAIN.schedule.load[:, FZ] == side * 9000.0 for side in (1, -1))
    offset = _difference(hidden.LoadEccentricity(FZ, (0.05, 0.02, 0.0)))
    assert_close(offset[up].mean(0), -offset[down].mean(0), atol=1e-12, what="m, rad")
    apart = _difference(hidden.LoadImbalance(FZ, (0.0,) * 6, (0.0, 0.0, 0.0, 0.02, 0.02, 0.0)))
    assert_close(apart[up].mean(0), apart[down].mean(0), atol=1e-12, what="m, rad")
    assert np.abs(apart[~under_fz]).max() == 0.0


def test_effects_of_stiffness_are_what_the_format_says() -> None:
    plain = PLAIN.readings
    schedule = PLAIN.schedule
    F, own = schedule.load[:, FZ], schedule.load[:, FZ] != 0
    x = (F / 10e3)[own, None]
    assert_close(draw([hidden.StiffnessScale(FZ, 0.25)]).readings[own], plain[own] / 1.25, atol=1e-15)
    asymmetric = plain[own] * (1 + 0.15 * np.sign(x))
    assert_close(draw([hidden.StiffnessAsymmetry(FZ, 0.3)]).readings[own], asymmetric, atol=1e-15)
    cubic = plain[own] * (1 + 0.3 * x**2)
    assert_close(draw([hidden.StiffnessNonlinear(FZ, 0.3)]).readings[own], cubic, atol=1e-15)
    play = _difference(hidden.JointClearance(FZ, 4e-6))
    assert_close(play[:, DZ], 2e-6 * np.sign(F), atol=1e-15, what="half of the play")
    assert not np.any(np.delete(play, DZ, axis=1))


def test_hysteresis_opens_on_the_way_down_and_closes_at_both_ends() -> None:
    loop = _difference(hidden.Hysteresis(FZ, 0.1))[:, DZ]
    schedule = PLAIN.schedule
    own = schedule.run == 3
    down = unloading(schedule.load, schedule.run)[own, FZ]
    largest = PLAIN.truth.machine.compliance[DZ, FZ] * 10e3
    F = schedule.load[own, FZ]
    assert not np.any(loop[own][~down])
    middle = down & (F == 5000.0)
    assert_close(loop[own][middle], [0.1 * largest], atol=1e-15, what="at half of the range")
    assert not np.any(loop[own][F == 0.0])
    assert np.all(loop[own][down & (F < 0)] < 0)


def test_creep_is_the_filter_of_the_load_that_is_held() -> None:
    """Steps 90 s apart: the last reading is the sum of all that went before, each forgotten by tau."""
    late = _difference(hidden.Creep((FZ,), 1.0, 200.0))
    own = PLAIN.schedule.run == 3
    d, time = PLAIN.readings[own], PLAIN.schedule.time_s[own]
    kept = np.exp(-(time[-1] - time) / 200.0)
    weight = kept[1:] - kept[:-1]
    assert_close(late[own][-1], (weight[:, None] * d[1:]).sum(0), atol=1e-12, what="m, rad")


def test_every_layout_of_the_bench_is_written_as_the_format_says(tmp_path: Path) -> None:
    layout = Layout("written", signals=8, programme=Programme(channels="own"))
    folder = write_campaign(draw([EFFECTS[0]], layout), tmp_path / "written", 7)
    rows = _rows(folder / "interferometer.csv")
    assert len(rows) == 6 * 21
    assert {(row["load_axis"], row["channel"]) for row in rows} == set(zip(AXES, CHANNELS, strict=True))
    assert len(_rows(folder / "signals.csv")[0]) == 4 + 8
    together = Layout("together", programme=Programme(together=2), written_as="displacement")
    rows = _rows(write_campaign(draw((), together), tmp_path / "together", 7) / "displacement.csv")
    assert len(rows) == 48
    assert {"fx_n", "mz_nm", "dx_mm", "rz_rad"} <= set(rows[0])


def test_noise_is_as_declared_and_a_run_has_one_zero() -> None:
    layout = Layout("noisy", programme=Programme(repeats=5, uneven=0.0))
    noisy, exact = draw((), layout), draw((), Layout("noisy", noise=Noise(exact=True), programme=layout.programme))
    off = (noisy.readings - exact.readings) / layout.noise.channels
    means = np.array([off[noisy.schedule.run == run].mean(0) for run in range(1, 31)])
    within = off - means[noisy.schedule.run - 1]
    assert_close(within.std(), np.sqrt(20 / 21), atol=0.03, what="within runs")
    assert_close(means.std(), np.sqrt(1 + 1 / 21), atol=0.15, what="between runs")


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_the_sample_is_written_again_to_the_byte(tmp_path: Path) -> None:
    folder = write_force_sensor(tmp_path / "force-sensor")
    kept = PROJECT / "sample_data" / "force-sensor"
    assert {path.name for path in kept.iterdir()} == {path.name for path in folder.iterdir()} | {"README.md"}
    for written in folder.iterdir():
        assert written.read_bytes() == (kept / written.name).read_bytes(), f"{written.name} is out of date"
    reported, before = (json.loads(truth_path(at).read_text(encoding="utf-8")) for at in (folder, kept))
    assert reported["effects"] == before["effects"]
    assert before["seed"] == SEED
    # Not to the byte: processors differ in the last digit.
    assert_close(reported["compliance"], before["compliance"], atol=1e-15)


def test_published_values_are_shown_with_those_of_the_sample() -> None:
    path = PROJECT / "docs" / "experiments" / "published_force_sensor.json"
    printed = json.loads(path.read_text(encoding="utf-8"))["maxima"]
    rows = _rows(PROJECT / "sample_data" / "force-sensor" / "published.csv")
    columns = {"theoretical_maximum": "theory", "measured_positive": "positive", "measured_negative": "negative"}
    for column, name in columns.items():
        assert [row[column] for row in rows] == [str(value) for value in printed[name]]


def test_the_sample_is_nominal_set_a_and_meets_table_2() -> None:
    compliance = build(LAYOUT.sensor, flawless(LAYOUT.sensor)).compliance
    found = 1000 * np.diag(compliance) / np.array([1e-6] * 3 + [ARCSEC] * 3)
    assert_close(found, [230.0, 190.0, 27.0, 82.0, 79.0, 67.0], atol=0.01, what="um and arc seconds per 1000 N or N m")
    assert np.abs(force_sensor_campaign().schedule.load).max(axis=0).tolist() == [9000.0] * 3 + [4500.0] * 3
