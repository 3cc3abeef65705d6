"""Causes of drives, instruments and targets: derivatives, candidates, and reported parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulation.mechanisms.telescope import sample_model
from tests.tolerance import assert_between, assert_close
from truing.simulation.cause import Cause
from truing.simulation.inputs import APPROACH, LAST_STEP, ORDER, OWN_DRIVE
from truing.simulation.mechanisms.causes.drive import ActuatorBacklash, ActuatorGain, PeriodicError, distinct_pitches
from truing.simulation.mechanisms.causes.measurement_scale import BOTH, MeasurementScale
from truing.simulation.mechanisms.causes.nonparametric import ALL_DRIVES, Quantity
from truing.simulation.mechanisms.causes.nonparametric import NonparametricMechanismEffect as Nonparametric
from truing.simulation.mechanisms.causes.per_leg import choice_share, choices
from truing.simulation.mechanisms.causes.targets import TargetMoved, TargetsSwapped
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.mechanisms.point_causes import PointScene
from truing.simulation.nonparametric import WAVES

STEP = 1e-30
POSES = 20
OWN = {"columns": (OWN_DRIVE,), "centres": (0.0,), "half_ranges": (1.3e-3,)}
TIME = {"columns": ("time_s",), "centres": (1800.0,), "half_ranges": (1800.0,)}
PRODUCT = {"columns": ("rho2_mm", "temperature_c"), "centres": (0.0, 21.0), "half_ranges": (1.3e-3, 1.0)}
CAUSES: tuple[Cause, ...] = (
    ActuatorGain(),
    ActuatorBacklash((2, 5)),
    PeriodicError((), 0.9),
    PeriodicError((1, 4), 0.9, 300.0, free=True),
    MeasurementScale(),
    MeasurementScale(BOTH),
    TargetMoved("platform", "T7", 5, 4.0),
    Nonparametric(quantity=Quantity.LENGTHS, degree=3, **OWN),
    Nonparametric(quantity=Quantity.ATTACHMENTS, legs=(3,), **PRODUCT),
    Nonparametric(quantity=Quantity.ATTACHMENTS_SIDEWAYS, degree=2, **OWN),
    Nonparametric(quantity=Quantity.SCALE, form=WAVES, degree=4, **TIME),
    Nonparametric(quantity=Quantity.TARGETS, body="base", targets=("T1", "T3"), degree=2, **TIME),
    Nonparametric(
        quantity=Quantity.TARGETS, body="platform", targets=("T6", "T8"), places=(1.0, -0.5, -1.0, 0.3), **PRODUCT
    ),
    Nonparametric(columns=(), centres=(), half_ranges=(1.3e-3,), form=ALL_DRIVES),
    Nonparametric(first=3, degree=4, **OWN),
)


def _model(causes: Sequence[Cause], kind: str = "6-pus") -> MechanismModel:
    rng = np.random.default_rng(3)
    model = sample_model(rng, POSES, tuple(causes), kind)
    bodies = tuple(("base", "platform", f"leg{leg + 1}")[body] for body, leg in _carriers(model))
    names = tuple(f"T{number}" for number in range(len(bodies)))
    covariates = {
        "temperature_c": rng.uniform(20.0, 22.0, POSES),
        "time_s": np.linspace(0.0, 3600.0, POSES),
        ORDER: np.arange(POSES) * 1.0,
        APPROACH: rng.choice([-1.0, 1.0], (POSES, 6)),
        LAST_STEP: rng.normal(0.0, 1e-3, (POSES, 6)),
    }
    conditions = replace(model.conditions, covariates=covariates, poses=tuple(range(1, POSES + 1)))
    return replace(model, targets=replace(model.targets, names=names, bodies=bodies), conditions=conditions)


def _carriers(model: MechanismModel) -> list[tuple[int, int]]:
    return [(int(body), int(leg)) for body, leg in zip(model.targets.body, model.targets.leg, strict=True)]


def _place(model: MechanismModel) -> tuple[NDArray, NDArray]:
    rng = np.random.default_rng(9)
    shared = rng.normal(size=model.shared_size)
    for cause in model.causes:
        shared[model.layout[cause.key]] *= 0.1
    return shared, rng.normal(size=(POSES, model.local_size))


def _assert_exact(model: MechanismModel, places: Sequence[int]) -> None:
    shared, local = _place(model)
    found = model.predict(shared, local)
    for j in places:
        expected = model.points(shared + 1j * STEP * (np.arange(len(shared)) == j), local).imag / STEP
        size = np.abs(expected).max()
        assert_close(found.by_shared[..., j], expected, atol=1e-11 * size, what="derivative by a parameter, m")
    for j in range(0, model.local_size, 3):
        expected = model.points(shared, local + 1j * STEP * (np.arange(model.local_size) == j)).imag / STEP
        size = np.abs(expected).max()
        assert_close(found.by_local[..., j], expected, atol=1e-11 * size, what="derivative by a reading, m")


@pytest.mark.parametrize("kind", ["6-pus", "ups"])
@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.key)
def test_derivatives_are_those_of_a_complex_step(cause: Cause, kind: str) -> None:
    model = _model([cause], kind)
    part = model.layout[cause.key]
    _assert_exact(model, range(part.start, part.stop)[:8])


def test_derivatives_hold_with_labels_exchanged_and_all_effects_at_once() -> None:
    swapped = TargetsSwapped("platform", ("T6", "T8"), (2, 3), (1.0, 2.0))
    model = _model([ActuatorGain(), *CAUSES[3:7], swapped, CAUSES[8]])
    _assert_exact(model, range(0, model.shared_size, 5))


def test_amplitude_pitch_and_phase_are_reported_as_the_sine_that_they_define() -> None:
    cause = PeriodicError((2, 5), 0.8, 300.0, free=True)
    size, phase = np.array([3e-6, 5e-6]), np.array([0.4, -2.0])
    waves = np.stack([size * np.cos(phase), size * np.sin(phase)], -1).ravel()
    reported = {t.name: t for t in cause.reported(np.array([*waves, 50.0]), np.diag([1e-14] * 4 + [25.0]), 6)}
    assert list(reported) == ["amplitude_2", "amplitude_5", "pitch", "phase_2", "phase_5"]
    for leg, a, p in zip((2, 5), size, phase, strict=True):
        assert_close(
            [reported[f"amplitude_{leg}"].value, reported[f"amplitude_{leg}"].sigma or 0], [a * 1e3, 1e-4], atol=1e-12
        )
        assert_close([reported[f"phase_{leg}"].value, reported[f"phase_{leg}"].sigma or 0], [p, 1e-7 / a], atol=1e-9)
    share = np.tanh(50.0 / 300.0)
    pitch = 1 / (1 / 0.8 + 0.3 * share)
    sigma = pitch**2 * 0.005 * (1 - share**2)
    assert_close([reported["pitch"].value, reported["pitch"].sigma or 0], [pitch, sigma], atol=1e-12)


def test_a_pitch_stays_among_those_that_are_searched() -> None:
    scene = _model([]).scene
    longest = max(PeriodicError().candidates(scene), key=lambda cause: cause.settings()["pitch_mm"]).refined()
    for away in (-1e6, 1e6):
        (pitch,) = (t for t in longest.reported(np.array([*np.ones(12), away]), np.eye(13), 6) if t.name == "pitch")
        assert_between(float(pitch.value), 0.2, 8.0, what="pitch, mm")


def test_a_declared_pitch_is_not_searched_for() -> None:
    scene = _model([]).scene
    given = PeriodicError().candidates(replace(scene, pitch_m=1e-3))
    assert {cause.settings()["pitch_mm"] for cause in given} == {1.0}
    assert all(cause.refined() is cause for cause in given)
    searched = PeriodicError().candidates(scene)
    assert all(cause.refined().settings()["free"] for cause in searched)


def test_no_pitch_falls_between_those_tried() -> None:
    """Of any sine's power over random displacements, the nearest pitch's waves keep most."""
    rng = np.random.default_rng(5)
    moved = rng.uniform(-1.3e-3, 1.3e-3, (60, 6))
    tried = distinct_pitches(moved)
    kept = []
    for pitch in 1 / np.linspace(1 / 5e-3, 1 / 0.2e-3, 400):
        wave = np.sin(2 * np.pi * moved[:, 0] / pitch + 1.0)
        wave -= wave.mean()
        share = []
        for other in tried:
            turn = 2 * np.pi * moved[:, 0] / other
            columns = np.stack([np.ones_like(turn), np.sin(turn), np.cos(turn)], -1)
            rest = wave - columns @ np.linalg.lstsq(columns, wave, rcond=None)[0]
            share.append(1 - rest @ rest / (wave @ wave))
        kept.append(max(share))
    assert_between(min(kept), 0.85, 1.0, what="smallest share of a sine's power")


def test_pitches_that_few_levels_cannot_distinguish_are_tried_once() -> None:
    levels = np.random.default_rng(6).integers(-1, 2, (40, 6)) * 1.3e-3
    assert len(distinct_pitches(levels)) == 1
    scene = replace(_model([]).scene, readings=levels + _model([]).scene.rho0)
    for cause in PeriodicError().candidates(scene):
        assert cause.refined() is cause
        (pitch,) = (t for t in cause.reported(np.ones(12), np.eye(12), 6) if t.name == "pitch")
        assert pitch.sigma == pitch.value  # nothing is known of it


def test_targets_are_tried_from_every_pose_that_has_three_on_either_side() -> None:
    scene = _model([]).scene
    is_observed = np.ones((POSES, len(scene.shape)), bool)
    is_observed[:5, 2] = is_observed[9, 3] = False
    (found,) = TargetMoved().channel_candidates(replace(scene, is_observed=is_observed))
    onsets = [int(np.argmax(values[:, 0])) for values in found.values]
    assert onsets == [0, *range(3, POSES - 2)]
    assert found.usable[:, 0].all()
    assert [onset for onset, usable in zip(onsets, found.usable[:, 2], strict=True) if usable] == [
        0,
        *range(8, POSES - 2),
    ]
    assert 9 not in [onset for onset, usable in zip(onsets, found.usable[:, 3], strict=True) if usable]
    member = found.member(7, onsets.index(4))
    assert member.settings() == {"body": "platform", "target": "T7", "from_pose": 5, "from_order": 4.0}
    assert member.subject == "target T7"
    assert [t.name for t in member.reported(np.ones(3), np.eye(3), 6)] == ["dx", "dy", "dz", "from_pose"]


def test_swapped_targets_are_reported_by_their_poses() -> None:
    (reported,) = TargetsSwapped("base", ("B1", "B2"), (4, "7b"), (3.0, 9.0)).reported(np.zeros(0), np.zeros((0, 0)), 6)
    assert (reported.name, reported.value, reported.sigma) == ("poses", "4 7b", None)


@pytest.mark.parametrize(
    "cause", [ActuatorGain(), ActuatorBacklash(), PeriodicError(), MeasurementScale(), Nonparametric()]
)
def test_candidates_differ_and_keep_their_settings(cause: Cause) -> None:
    scene = _model([]).scene
    found = cause.candidates(scene)
    assert len({candidate.key for candidate in found}) == len(found) > 1
    for candidate in found:
        again = cause.with_settings(**candidate.settings())
        assert again == candidate
        assert again.step is candidate.step
        assert candidate.prior(scene) > 0


def test_candidates_are_those_that_could_show() -> None:
    scene = replace(_model([]).scene, covariates={})
    assert not ActuatorBacklash().candidates(scene)
    assert [cause.settings()["form"] for cause in MeasurementScale().candidates(scene)] == ["constant"]
    assert not TargetMoved().channel_candidates(scene)


def test_nonparametric_effects_exclude_the_forms_of_the_catalogue() -> None:
    """Neither a gain, nor backlash, nor a linear deformation of the platform is among what may follow."""
    for cause in Nonparametric().candidates(_model([]).scene):
        own = cause.settings()
        in_proportion = own["columns"] == (OWN_DRIVE,) and own["degree"] == 1
        assert not (own["quantity"] in (Quantity.READINGS, Quantity.ATTACHMENTS) and in_proportion)
        assert APPROACH not in own["columns"]


def test_a_nonparametric_effect_names_its_input_columns() -> None:
    assert Nonparametric(legs=(3,), **OWN).inputs(6) == ("rho3_mm",)
    assert Nonparametric(**PRODUCT).inputs(6) == ("rho2_mm", "temperature_c")
    assert Nonparametric(columns=(ORDER,), centres=(0.0,), half_ranges=(1.0,)).inputs(6) == ("time_s",)
    assert Nonparametric(legs=(1,), columns=(LAST_STEP,), centres=(0.0,), half_ranges=(1.0,)).needs(6) == (
        "rho1_mm",
        "time_s",
    )


def test_further_terms_of_a_form_begin_where_it_ends() -> None:
    """Of all legs that it concerns or of single ones; together with it they are the form of the higher degree."""
    model = _model([])
    found = Nonparametric(degree=2, legs=(2, 5), **OWN)
    further = found.higher_order_terms(model.scene)
    assert {(own.legs, own.first, own.degree) for own in further} == {
        (legs, 3, degree) for legs in ((2, 5), (2,), (5,)) for degree in (3, 4)
    }
    assert all(own.is_higher_order and not found.is_higher_order for own in further)
    assert len({found.key, *(own.key for own in further)}) == 7
    own = next(own for own in further if own.legs == (5,) and own.degree == 4)
    assert [p.name for p in own.parameters(6)] == ["leg5_degree3", "leg5_degree4"]
    assert own.with_settings(**own.settings()) == own
    state = model.state(np.zeros(model.shared_size), np.zeros((POSES, model.local_size)))
    whole = Nonparametric(degree=4, legs=(5,), **OWN).functions(state)
    assert np.array_equal(own.functions(state), whole[..., 2:])
    assert not Nonparametric(columns=(), centres=(), half_ranges=(1.3e-3,), form=ALL_DRIVES).higher_order_terms(
        model.scene
    )


def test_choices_of_legs_share_their_probability() -> None:
    for legs in (3, 4, 6, 8):
        total = sum(choice_share(len(chosen), legs) for chosen in choices(legs))
        assert_between(total, 1 - 1e-12, 1 + 1e-12, what=f"sum over choices of {legs} legs")
    assert len(choices(20)) == 1 + 20 + 190


def test_a_body_without_legs_has_targets_that_follow_columns() -> None:
    model = _model([])
    scene: PointScene = replace(model.scene, readings=np.zeros((POSES, 0)), rho0=np.zeros(0))
    quantities = {cause.settings()["quantity"] for cause in Nonparametric().candidates(scene)}
    assert quantities == {Quantity.SCALE}
    single, waves = Nonparametric().channel_candidates(scene)
    assert single.values.shape[1:] == (POSES, 1)
    assert waves.member(3, 0).settings()["targets"] == ("T3",)
