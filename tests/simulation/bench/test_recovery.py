"""Effects hidden in the readings of a bench are named with their sizes; without effects, nothing is found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulation.bench.sensor_benches import SIGMA, Bench, bench
from truing.inference.observations import Epochs, Frames, Observations
from truing.inference.selection import CauseDiagnosis, CauseSelection, Settings
from truing.inference.verdicts import FOUND
from truing.simulation.bench.causes.beams import CosineError
from truing.simulation.bench.causes.leg_stiffness import LegStiffness
from truing.simulation.bench.causes.noise_burst import NoisyRun
from truing.simulation.bench.causes.play_hysteresis import PlayHysteresis
from truing.simulation.bench.causes.reading_causes import ReadingCause
from truing.simulation.bench.causes.signal_hysteresis import SignalHysteresis
from truing.simulation.bench.causes.signal_nonlinear import CUBIC, QUADRATIC, SignalNonlinear
from truing.simulation.bench.causes.zero_step import ZeroStep
from truing.simulation.bench.load_steps import CHANNELS, ReadingState
from truing.simulation.bench.six_upur.loading import AXES
from truing.simulation.catalogue import catalogue_of_readings

SETTINGS = Settings(0.05, 100, 1)
WITHIN = 3.3  # sigmas: one in a thousand lies beyond
SCALE_V = 0.01  # of the signals of the bench, about

# A cause with what is hidden of it, SI.
HIDDEN: dict[str, tuple[ReadingCause, list[float]]] = {
    "soft leg": (LegStiffness(3), [float(np.log(0.7))]),
    "beam askew": (CosineError("dz"), [0.004, -0.003]),
    "knock": (ZeroStep(CHANNELS, 4, 8, 8, tuple((10.0 * SIGMA[:6]).tolist())), (3.0 * SIGMA[:6]).tolist()),
    "play with friction": (PlayHysteresis("fz", 0.2, exercised=True, free=True), [0.008, 0.0]),
    "square of a signal": (SignalNonlinear("v2", (QUADRATIC,), (), ("v2",), (SCALE_V,)), [4.0]),
    "cube of a signal": (SignalNonlinear("v2", (CUBIC,), (), ("v2",), (SCALE_V,)), [-900.0]),
}


def read(
    own: Bench,
    cause: ReadingCause | None,
    values: list[float],
    seed: int = 3,
    noisier: NDArray | float = 1.0,
) -> Epochs:
    """Readings of the bench with a nominal sensor, a cause, and noise that may be larger in places."""
    model = own.model(*([cause] if cause else []))
    shared = np.zeros(model.shared_size)
    if cause:
        shared[model.layout[cause.key]] = np.array(values) / model.effect_sigma(cause)
    steps = len(own.conditions.load)
    exact = model.points(shared, np.zeros((steps, model.local_size)))
    noisier = np.broadcast_to(noisier, exact.shape[:2])
    noise = np.random.default_rng(seed).normal(size=exact.shape) * SIGMA[:, None] * noisier[..., None]
    covariance = np.broadcast_to(SIGMA[:, None, None] ** 2, (*exact.shape, 1)).copy()
    return Epochs(Observations(exact + noise, covariance, own.is_observed), own.conditions, Frames.of_numbers(steps))


@cache
def searched(name: str, seed: int = 3) -> CauseDiagnosis[ReadingCause]:
    """Diagnosis by the whole catalogue with one hidden cause; no hidden cause for an empty name."""
    own = bench()
    cause, values = HIDDEN.get(name, (None, []))
    search = CauseSelection(own.model(), read(own, cause, values, seed), None, SETTINGS)
    return search.run(tuple(catalogue_of_readings().values()))


@pytest.mark.parametrize("name", HIDDEN)
def test_a_hidden_cause_is_found_under_its_name_with_its_size(name: str) -> None:
    cause, values = HIDDEN[name]
    found = [verdict for verdict in searched(name).verdicts if verdict.verdict == FOUND]
    assert [(one.cause.id, one.cause.subject) for one in found] == [(cause.id, cause.subject)]
    reported = {one.name: one for one in found[0].cause.reported(found[0].values, found[0].covariance, 6)}
    truth = cause.reported(np.array(values), np.zeros((len(values), len(values))), 6)
    for one in truth:
        if one.name in reported and reported[one.name].sigma is not None:
            assert abs(reported[one.name].value - one.value) < WITHIN * reported[one.name].sigma
            assert reported[one.name].sigma < 0.3 * abs(one.value)


def test_hysteresis_of_signals_is_asked_where_no_deflection_is_read() -> None:
    model = bench().model()
    alone = model.scene.steps
    assert not SignalHysteresis().candidates(model.scene)
    recorded = np.ones((len(alone.run), len(alone.channels)), bool)
    recorded[:, :6] = False
    scene = replace(model.scene, is_observed=recorded)
    loop, play = (SignalHysteresis("fz", threshold) for threshold in (0.0, 0.15))
    assert {loop.key, play.key} <= {one.key for one in SignalHysteresis().candidates(scene)}
    state = ReadingState(alone, alone.load, np.zeros((len(alone.run), 6, 0)), np.zeros((len(alone.run), 0)))
    for cause in (loop, play):
        felt = cause.slopes(state, np.zeros(1))[:, AXES.index("fz"), 0]
        back = alone.unloading[:, AXES.index("fz")] & (alone.load[:, AXES.index("fz")] != 0.0)
        assert np.all(felt[back] * np.sign(alone.load[back, AXES.index("fz")]) > -1e-12), "more on the way back"
        assert np.abs(felt).max() <= 1.0001 * alone.largest[AXES.index("fz")]


@pytest.mark.parametrize("seed", [3, 4])
def test_a_clean_bench_is_silent(seed: int) -> None:
    assert [verdict.cause.key for verdict in searched("", seed).verdicts if verdict.verdict == FOUND] == []


@pytest.mark.parametrize("channel", ["displacements", "v4"])
def test_a_noisy_run_is_reported_as_noise_and_not_as_a_shift(channel: str) -> None:
    """Weights that are hung elsewhere each time, a loose plug: nothing moves on average."""
    own = bench()
    code, names = own.model().steps.code, own.model().channel_names
    places = (code == code[-1])[:, None] & np.array(
        [channel == (name if channel[0] == "v" else {"v": "signals"}.get(name[0], "displacements")) for name in names]
    )
    epochs = read(own, None, [], 5, np.where(places, 6.0, 1.0))
    reported = CauseSelection(own.model(), epochs, None, SETTINGS).run(tuple(catalogue_of_readings().values()))
    assert [verdict.cause.key for verdict in reported.verdicts if verdict.verdict == FOUND] == []
    (burst,) = reported.noise_dependences
    assert isinstance(burst.driver.cause, NoisyRun)
    assert burst.driver.cause.channel == channel
    assert abs(burst.ratio - 6.0) < WITHIN * burst.sigma < 4.0


def _with_courses(courses: NDArray, seed: int) -> list[str]:
    """Subjects of named causes that are found where a channel (dz) is moved by courses (B,) in units of its noise."""
    own = bench()
    epochs, moved = read(own, None, [], seed), CHANNELS.index("dz")
    values = epochs.measured.values.copy()
    values[:, moved, 0] += courses * SIGMA[moved]
    epochs = replace(epochs, measured=replace(epochs.measured, values=values))
    reported = CauseSelection(own.model(), epochs, None, SETTINGS).run(tuple(catalogue_of_readings().values()))
    found = [verdict for verdict in reported.verdicts if verdict.verdict == FOUND]
    return [verdict.cause.subject for verdict in found if verdict.cause.catalogued]


@pytest.mark.parametrize("seed", [6, 10])
def test_a_channel_that_wanders_in_some_runs_is_not_named_after_a_drift_in_one(seed: int) -> None:
    """Draws that drifts and slips of single runs describe, though one random walk does as well."""
    code = bench().model().steps.code
    steps = np.random.default_rng(seed).normal(size=len(code))
    walk = sum(np.where(code == run, np.cumsum(np.where(code == run, steps, 0.0)), 0.0) for run in (0, 2, 5))
    assert _with_courses(walk, seed) == []


def test_zeros_that_drift_in_two_runs_are_named() -> None:
    steps = bench().model().steps
    within = np.where(np.isin(steps.code, (1, 4)), steps.rank, 0) * np.where(steps.code == 4, -1.0, 1.0)
    runs = [f"run {steps.run[steps.code == code][0]} channel dz" for code in (1, 4)]
    assert sorted(_with_courses(1.5 * within, 3)) == sorted(runs)
