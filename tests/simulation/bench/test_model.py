"""The model of a loaded sensor: predictions, derivatives, and effects of candidates."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulation.bench.sensor_benches import ARCSEC, GAINS, LARGEST, SIGMA, bench
from tests.tolerance import assert_close
from truing.inference.model import PartialDesign
from truing.simulation.bench.causes.beams import AbbeOffset, CosineError
from truing.simulation.bench.causes.channels import DeadPath, ThermalDrift, ZeroDrift
from truing.simulation.bench.causes.counts import Crosstalk, FringeSlip
from truing.simulation.bench.causes.leg_stiffness import LegStiffness
from truing.simulation.bench.causes.load_history import Creep
from truing.simulation.bench.causes.load_path import ASYMMETRY, GROWTH, RATIO, LoadEccentricity, LoadImbalance
from truing.simulation.bench.causes.nonparametric import BEYOND, GAIN, REST, NonparametricReadingEffect, fading_times
from truing.simulation.bench.causes.play_hysteresis import PlayHysteresis
from truing.simulation.bench.causes.signal_hysteresis import SignalHysteresis
from truing.simulation.bench.causes.signal_nonlinear import CUBIC, QUADRATIC, SignalNonlinear
from truing.simulation.bench.causes.stiffness import (
    Hysteresis,
    JointClearance,
    StiffnessAsymmetry,
    StiffnessNonlinear,
    StiffnessScale,
)
from truing.simulation.bench.known_readings import Optics, SignalGains
from truing.simulation.bench.load_steps import AIR, CHANNELS, HUMIDITY, LOADS, MATERIAL, PRESSURE
from truing.simulation.bench.model import BenchModel
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.simulation.bench.six_upur.loading import AXES
from truing.simulation.catalogue import catalogue_of_readings
from truing.simulation.cause import Cause

STEP = 1e-30
# One of every kind, and all together: what is downstream changes what is upstream, in the order in which they act.
MANY: tuple[Cause, ...] = (
    LoadEccentricity("fz"),
    LoadImbalance("mx", ("y", "z"), (RATIO, GROWTH)),
    StiffnessScale("fx", own=True),
    LegStiffness(4, "3 spring axial"),
    Creep("", 90.0, free=True),
    Hysteresis("fz"),
    PlayHysteresis("fy", 0.23, free=True),
    Creep("mz", 300.0),
    CosineError("dx"),
    AbbeOffset(),
    SignalHysteresis("fz", 0.15),
    ZeroDrift("v2"),
    Crosstalk("v3", "v2"),
    SignalNonlinear("", (QUADRATIC, CUBIC), ("fx-fx", "fy-mz"), ("v2", "v5"), (0.01, 0.02)),
)


def _unknowns(model: BenchModel, size: float = 0.3) -> tuple[NDArray, NDArray]:
    rng = np.random.default_rng(7)
    return rng.normal(0.0, size, model.shared_size), rng.normal(size=(len(model.conditions.run), model.local_size))


def _askew(model: BenchModel) -> BenchModel:
    """Every channel a little off its axis and its point, none of it known exactly, and a frame that grows."""
    rng = np.random.default_rng(5)
    off = rng.normal(0.0, 0.02, (3, 6, 6))
    optics = Optics(np.eye(6) + off[0], off[1:], 1e-7 * np.eye(6)[[0, 2]])
    return replace(model, known=replace(model.known, optics=optics))


@pytest.mark.parametrize("signals", [True, False])
def test_derivatives_are_exact(signals: bool) -> None:
    causes = MANY if signals else tuple(cause for cause in MANY if "v2" not in str(cause.settings().values()))
    model = _askew(bench(load_sigma=1e-3).model(*causes, signals=signals))
    shared, local = _unknowns(model)
    found = model.predict(shared, local)
    noise = model.known.sigma[:, None, None]
    assert found.zero_columns is not None
    by_shared = found.zero_columns.before(found.by_shared)
    for part, size, slopes in (("shared", model.shared_size, by_shared), ("local", 6, found.by_local)):
        for n in range(size):
            nudge = 1j * STEP * np.eye(size)[n]
            at = (shared + nudge, local) if part == "shared" else (shared, local + nudge)
            exact = model.points(*at).imag / STEP / noise[..., 0]
            reported = slopes[..., n] / noise[..., 0]
            assert_close(reported, exact, atol=1e-11 * max(np.abs(exact).max(), 1.0), what=f"{part} {n}")
    assert_close(found.values, model.points(shared, local), atol=0.0)


def test_candidates_act_as_they_do_once_they_are_among_the_unknowns() -> None:
    """A search receives the derivative of the prediction at zero for a candidate, whatever was accepted before."""
    model = bench().model(*MANY)
    shared, local = _unknowns(model)
    design_matrix, partial_designs = model.design_matrix(shared, local), model.partial_designs(shared, local)
    for kind in catalogue_of_readings().values():
        for cause in [c for c in kind.candidates(model.scene) if all(c.key != own.key for own in MANY)][::211]:
            wider = model.with_causes((*model.causes, cause))
            found = wider.predict(model.embedded(shared, wider), local)
            assert found.zero_columns is not None
            slopes = found.zero_columns.before(found.by_shared)[:, :, 0, wider.layout[cause.key]]
            design = design_matrix(cause)["observed"]
            if isinstance(partial := partial_designs(cause)["observed"], PartialDesign):
                assert_close(partial.values, design[:, partial.places], atol=0.0, what=cause.key)
                assert not np.delete(design, partial.places, 1).any()
            expected = slopes / cause.reach / SIGMA[:, None]
            atol = 1e-11 * max(np.abs(expected).max(initial=0.0), 1e-9)
            assert_close(design / SIGMA[:, None], expected, atol=atol, what=cause.key)


def test_a_plain_sensor_answers_in_proportion() -> None:
    own = bench(lone=True)
    model = own.model()
    shared = np.zeros(model.shared_size)
    shared[model.layout["zero"]] = np.arange(len(model.known.zeros.run))
    shared[model.layout["legforce"]] = 0.5  # what runs along elastic legs
    points = model.points(shared, np.zeros((len(own.conditions.run), 0)))[..., 0]
    load = own.conditions.load
    forces = own.sensor.axial_forces @ load.T
    first = points[own.conditions.step == 0]
    for k in range(12):  # less the run's zero, which is what it reads without load
        plain = load @ own.sensor.compliance[k] if k < 6 else GAINS[k - 6] * forces[k - 6]
        gap = points[:, k] - plain - first[own.conditions.run - 1, k]
        assert np.abs(gap[own.is_observed[:, k]]).max() < 1e-9 * SIGMA[k] + 1e-12 * np.abs(plain).max()
    shared[model.layout["legforce"]] = -0.5  # joints that resist nothing
    forces = np.linalg.solve(influence_matrix(own.sensor.joints), load.T)
    found = model.points(shared, np.zeros((len(load), 0)))[:, 6, 0] - first[own.conditions.run - 1, 6]
    assert_close(found, GAINS[0] * forces[0], atol=1e-12)


def _effects() -> dict[str, tuple[Cause, list[float], int, NDArray]]:
    """A cause, its values (SI), a channel, and what is added to its readings by a formula of its own."""
    own = bench()
    load, time, run = own.conditions.load, own.conditions.time_s, own.conditions.run
    C, air = own.sensor.compliance, own.conditions.covariates
    fz, mx = load[:, 2], load[:, 3]
    start = np.array([np.flatnonzero(run == r)[0] for r in run])
    motion = load @ C.T
    crept = np.zeros(len(run))
    down = np.zeros(len(run))
    for n in range(1, len(run)):
        if run[n] == run[n - 1]:
            kept = np.exp(-(time[n] - time[n - 1]) / 80.0)
            crept[n] = kept * crept[n - 1] + (1 - kept) * motion[n, 2]
            down[n] = abs(fz[n]) < abs(fz[n - 1])
    x = np.abs(fz) / LARGEST[2]
    moment = np.stack([0.004 * fz, -0.003 * fz], -1)
    forces = np.linalg.inv(influence_matrix(own.sensor.joints)) * 0.5 + 0.5 * own.sensor.axial_forces
    return {
        "eccentric": (LoadEccentricity("fz"), [0.003, 0.004], 3, moment @ C[3, 3:5]),
        "torque": (LoadEccentricity("mx"), [0.0, 0.02, 0.0], 1, 0.02 * mx * C[1, 1]),
        "imbalance": (LoadImbalance("fz", ("x",)), [0.001, 0.003], 1, C[1, 3] * (0.001 * fz + 0.0015 * np.abs(fz))),
        "growth": (
            LoadImbalance("mx", ("z",), (RATIO, GROWTH)),
            [0.1, 0.2],
            2,
            C[2, 2] * mx * (0.1 + 0.2 * np.abs(mx) / LARGEST[3]),
        ),
        "scale": (StiffnessScale("fz"), [0.05], 2, C[2, 2] * fz * (1 / 1.05 - 1)),
        "scale elsewhere": (StiffnessScale("fz", own=True), [0.05], 3, np.zeros(len(fz))),
        "asymmetry": (StiffnessAsymmetry("mx"), [0.02], 1, 0.01 * np.abs(mx) * C[1, 3]),
        "cubic": (StiffnessNonlinear("fz"), [0.03], 2, 0.03 * C[2, 2] * fz**3 / LARGEST[2] ** 2),
        "hysteresis": (
            Hysteresis("fz"),
            [0.02],
            2,
            down * 0.02 * C[2, 2] * LARGEST[2] * np.sign(fz) * 4 * x * (1 - x),
        ),
        "clearance": (JointClearance("fz"), [4e-6], 2, 2e-6 * np.sign(fz)),
        "creep": (Creep("", 80.0), [0.03], 2, 0.03 * crept),
        "zero": (ZeroDrift("rz", 3, True), [ARCSEC], 5, ARCSEC * (time - time[start]) * (run == 3)),
        "warm": (ThermalDrift("", (MATERIAL,)), [2e-6], 1, 2e-6 * (air[MATERIAL] - air[MATERIAL][start])),
        "angle": (
            CosineError("dx"),
            [0.03, 0.04],
            0,
            (np.cos(0.05) - 1) * motion[:, 0] + np.sin(0.05) * motion[:, 1:3] @ [0.6, 0.8],
        ),
        "lost": (CosineError("rx", along=True), [0.001], 3, -0.001 * motion[:, 3]),
        "arm": (AbbeOffset("dz"), [0.01, 0.02], 2, np.cross(motion[:, 3:], [0.01, 0.02, 0.0])[:, 2]),
        "slip": (FringeSlip("dz", 3, 7, 7), [-2.0], 2, -2 * 316.495e-9 * ((run == 3) & (own.conditions.step >= 7))),
        "jump": (
            NonparametricReadingEffect(("fz_n",), (0.0,), (4e3,), BEYOND, 2, channel="rx"),
            [2 * ARCSEC, -ARCSEC],
            3,
            2 * ARCSEC * (fz > 4e3) - ARCSEC * (fz < -4e3),
        ),
        "gain": (
            NonparametricReadingEffect(("fz_n", AIR), (0.0, 20.0), (1e4, 2.0), GAIN, 2, channel="dy"),
            [1e-6, 3e-6],
            1,
            fz / 1e4 * (1e-6 + 3e-6 * (air[AIR] - 20.0) / 2.0),
        ),
        "crosstalk": (Crosstalk("v3", "v5"), [0.02], 8, 0.02 * GAINS[4] * load @ forces[4]),
    }


@pytest.mark.parametrize("name", _effects())
def test_an_effect_is_what_its_formula_says(name: str) -> None:
    cause, values, channel, expected = _effects()[name]
    own = bench()
    plain, model = own.model(), own.model(cause)
    shared, local = np.zeros(model.shared_size), np.zeros((len(own.conditions.run), 0))
    shared[model.layout[cause.key]] = values / model.effect_sigma(cause)
    found = model.points(shared, local) - plain.points(np.zeros(plain.shared_size), local)
    assert_close(found[:, channel, 0], expected, atol=1e-6 * SIGMA[channel], what=name)


@pytest.mark.parametrize(
    ("cause", "parameter", "axis", "brought"),
    [
        (LoadImbalance("fx", ("z",), (RATIO, ASYMMETRY)), "moment_z", 0, 5),
        (LoadImbalance("mx", ("y",), (RATIO, GROWTH)), "force_y", 3, 1),
        (LoadEccentricity("fy"), "offset_x", 1, 5),
        (LoadEccentricity("mz"), "force_z", 5, 2),
    ],
)
def test_free_gains_absorb_a_ratio_of_loads_with_its_effect_on_load_errors(
    cause: Cause, parameter: str, axis: int, brought: int
) -> None:
    """Gains A under loads F give the signals of gains A / (1 + R) under loads (1 + R) F, whatever errors F has."""
    own, ratio, rng = bench(load_sigma=1e-3).model(cause), 0.42, np.random.default_rng(4)
    gains = rng.normal(1e-6, 3e-7, (6, 6))
    taken_up = gains - ratio * np.outer(gains[:, brought], np.eye(6)[axis])
    index = [one.name for one in cause.parameters(6)].index(parameter)
    local = rng.normal(size=(len(own.conditions.run), own.local_size))

    def predicted(start: NDArray, value: float) -> Any:
        model = replace(own, known=replace(own.known, gains=SignalGains(start, np.ones((6, 6)))))
        shared = np.zeros(model.shared_size)
        shared[model.layout[cause.key].start + index] = value / model.effect_sigma(cause)[index]
        return model.predict(shared, local)

    plain, turned = predicted(gains, 0.0), predicted(taken_up, ratio)
    for reported, expected in ((turned.values, plain.values), (turned.by_local, plain.by_local)):
        signals = expected[:, len(CHANNELS) :]
        assert_close(reported[:, len(CHANNELS) :], signals, atol=1e-12 * np.abs(signals).max())


def test_air_stretches_a_dead_path() -> None:
    """A metre of it is longer by 0.27 um where the pressure rises by a hectopascal, shorter by 0.95 um per kelvin."""
    own = bench()
    model = own.model(DeadPath("dy"))
    shared, local = np.zeros(model.shared_size), np.zeros((len(own.conditions.run), 0))
    shared[model.layout[model.causes[0].key]] = 1.0 / model.effect_sigma(model.causes[0])
    found = (model.points(shared, local) - own.model().points(shared[:-1], local))[:, 1, 0]
    since = np.stack([model.steps.since_first(column) for column in (PRESSURE, AIR, HUMIDITY)], -1)
    slopes = np.linalg.lstsq(since, found, rcond=None)[0]
    assert slopes[:2] == pytest.approx([0.27e-6, -0.95e-6], rel=0.03)


def test_the_catalogue_omits_causes_that_the_campaign_cannot_show() -> None:
    scene = bench(lone=True).model(signals=False).scene
    tried = {name: kind.candidates(scene) for name, kind in catalogue_of_readings().items()}
    assert not tried["crosstalk"]
    assert all(len({cause.key for cause in own}) == len(own) for own in tried.values())
    assert 500 < sum(map(len, tried.values())) < 2500
    assert {cause.subject for cause in tried["stiffness-scale"]} == {"", *(f"load {axis}" for axis in AXES)}


def test_no_block_takes_all_readings_of_a_channel_or_of_an_axis() -> None:
    """With one channel a run, what concerns that channel must be learned from its other runs."""
    own = bench(lone=True)
    blocks, load = own.model(signals=False).blocks, own.conditions.load != 0.0
    for block in np.unique(blocks):
        left = blocks != block
        assert own.is_observed[left][:, :6].any(0).all(), "a channel is left out altogether"
        assert load[left].any(0).all(), "an axis is left out altogether"
    assert all(len(np.unique(blocks[own.conditions.run == run])) == 1 for run in (1, 18, 36))


def test_an_angle_is_reported_by_its_cosine_loss_where_nothing_else_determines_it() -> None:
    own = bench(lone=True)
    scene = own.model().scene
    fz, dz = LOADS.index("fz_n"), CHANNELS.index("dz")
    along = scene.steps.load[:, fz] != 0.0
    only = np.zeros_like(own.is_observed)
    only[along, dz] = own.is_observed[along, dz]
    alone = CosineError().candidates(replace(scene, is_observed=only))
    assert CosineError("dz", along=True) in alone
    assert CosineError("dz", along=True) not in CosineError().candidates(replace(scene, is_observed=own.is_observed))


def test_fading_times_exist_only_after_a_break() -> None:
    steps = bench().model().steps
    late = (steps.run == 2) & (steps.rank >= 7)
    broken = replace(steps, time_s=steps.time_s + 3000.0 * (late | (steps.run > 2)))
    everywhere = np.ones(len(steps.run), bool)
    assert not len(fading_times(steps, everywhere))
    assert np.median(steps.held_s) <= fading_times(broken, everywhere)[0] < 200.0
    state: Any = SimpleNamespace(steps=broken)
    found = NonparametricReadingEffect(channel="dy", half_ranges=(200.0,), form=REST).slopes(state, np.ones(1))
    since = np.where(late, broken.time_s - broken.time_s[late].min(), np.inf)
    expected = np.exp(-since[:, None] / 200.0) * (np.array(broken.channels) == "dy")
    assert_close(found[..., 0], expected, atol=1e-12, what="since the break")
