"""A serial arm without legs works in truing/inference with a model, a scene and causes of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3
from truing.inference.observations import Epochs, Frames, Observations
from truing.inference.search_end import SearchEnd
from truing.inference.selection import CauseDiagnosis, CauseSelection, Settings
from truing.inference.verdicts import Reason
from truing.simulation.cause import OBSERVED, Cause, Effect, Parameter, Scene, Step
from truing.simulation.effects_model import EffectsModel, Prediction
from truing.simulation.inputs import ranks
from truing.simulation.trace import Trace
from truing.stages.diagnosis.cause_tables import adequacy_table

JOINTS, POSES, NOISE_M, LENGTH_SIGMA_M = 3, 40, 1e-5, 1e-3
AXES = np.eye(3)[[2, 1, 1]]  # the first joint turns about the vertical, the others about the link's y
LENGTHS = np.array([0.3, 0.4, 0.3])  # of what each joint carries, m
TARGETS = np.array([[0.03, 0.0, 0.0], [-0.02, 0.03, 0.0], [0.0, -0.03, 0.02], [0.01, 0.01, 0.05]])
_STEP = 1e-30


@dataclass(frozen=True)
class ArmState:
    """Joint angles (B, 3), rad, and points (B, K, 3), m."""

    angles: NDArray
    points: NDArray


@dataclass(frozen=True)
class ArmConditions:
    """Joint readings (B, 3), rad, in the order of time."""

    readings: NDArray

    @property
    def covariates(self) -> Mapping[str, NDArray]:
        return {"order": np.arange(len(self.readings), dtype=float)}


@dataclass(frozen=True)
class ArmScene(Scene["JointGain"]):
    """Inputs for the causes of an arm."""

    conditions: ArmConditions
    shape: NDArray
    legs: int = JOINTS

    @property
    def covariates(self) -> Mapping[str, NDArray]:
        return self.conditions.covariates


@dataclass(frozen=True)
class JointGain(Cause[ArmScene]):
    """One joint turns by a factor more than its encoder says."""

    joint: int = 0

    id = "joint-gain"
    step = Step.DRIVE

    @property
    def subject(self) -> str:
        return f"joint{self.joint + 1}"

    def candidates(self, scene: ArmScene) -> Sequence[Self]:
        return [replace(self, joint=joint) for joint in range(JOINTS)]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        return (Parameter("gain", "1", 1e-3),)

    def shift(self, angles: NDArray, values: NDArray) -> NDArray:
        return angles * (np.arange(JOINTS) == self.joint) * values[0]


def arm_points(angles: NDArray, lengths: NDArray) -> NDArray:
    """The targets (B, K, 3) of the last link, whose frame follows one joint after the other; complex-safe."""
    points = np.broadcast_to(TARGETS, (len(angles), *TARGETS.shape))
    for axis, length, angle in zip(AXES[::-1], lengths[::-1], angles.T[::-1], strict=True):
        R = exp_so3(angle[:, None] * axis)
        points = (points + length * np.eye(3)[2]) @ np.swapaxes(R, -1, -2)
    return points


def _applied(effect: Effect[JointGain], state: ArmState) -> ArmState:
    return replace(state, angles=state.angles + effect.cause.shift(state.angles, effect.values))


@dataclass(frozen=True)
class ArmModel(EffectsModel[JointGain]):
    """An arm whose links are known to a tolerance; unknowns are their lengths."""

    conditions: ArmConditions

    channel_word = "target"
    channel_names = tuple(f"P{k + 1}" for k in range(len(TARGETS)))
    part_count = JOINTS
    local_size = 0

    @property
    def _sizes(self) -> dict[str, int]:
        return {"links": JOINTS}

    @property
    def unpredicted(self) -> NDArray:
        return np.zeros(0, bool)

    @property
    def _shared_known(self) -> NDArray:
        return np.arange(self.shared_size) < JOINTS

    @property
    def channel_groups(self) -> NDArray:
        return np.zeros(len(TARGETS), int)

    @property
    def blocks(self) -> NDArray:
        return ranks(self.conditions.covariates["order"])

    @property
    def scene(self) -> ArmScene:
        return ArmScene(self.conditions, TARGETS)

    def at(self, conditions: ArmConditions) -> Self:
        return replace(self, conditions=conditions)

    def rescaled(self, readings: float, survey: float) -> Self:
        return self

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """The targets (B, K, 3), m, at shared unknowns (G,)."""
        start = ArmState(self.conditions.readings, np.empty((0, 0, 3)))
        driven = Trace(start, (), {}).through(Step.DRIVE, self.effects(shared), _applied)
        return arm_points(driven.state.angles, LENGTHS + LENGTH_SIGMA_M * shared[self.layout["links"]])

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        points = self.points(shared, local)
        slopes = None
        if by_shared:
            steps = 1j * _STEP * np.eye(self.shared_size)
            slopes = np.stack([self.points(shared + step, local).imag / _STEP for step in steps], -1)
        return self._prediction(shared, points, slopes, np.zeros((*points.shape, 0)))

    def rotations(self, shared: NDArray, local: NDArray) -> NDArray:
        return np.broadcast_to(np.eye(3), (len(self.conditions.readings), len(TARGETS), 3, 3))

    def pathways(self, shared: NDArray, local: NDArray) -> dict[str, NDArray]:
        return {}

    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[JointGain], dict[str, NDArray]]:
        def found(cause: JointGain) -> dict[str, NDArray]:
            model = self.with_causes([*self.causes, cause])
            wide = self.embedded(shared, model)
            slope = model.predict(wide, local).by_shared[..., model.layout[cause.key]]
            own = slope / model.effect_sigma(cause) * model.effect_scale(cause)
            return {OBSERVED: own.reshape(len(own), -1, own.shape[-1])}

        return found


def diagnosed(gain: float, seed: int = 4) -> CauseDiagnosis:
    """Diagnosis of a drawn campaign with a gain of the second joint; the frame of measurement is the base's."""
    rng = np.random.default_rng(seed)
    readings, lengths = rng.uniform(-1.0, 1.0, (POSES, JOINTS)), rng.normal(size=JOINTS)
    return searched(epochs_of(readings, lengths, [0.0, gain, 0.0], rng), None)


def epochs_of(readings: NDArray, lengths: NDArray, gains: Sequence[float], rng: np.random.Generator) -> Epochs:
    """Epochs measured with noise at joint readings (B, 3) of an arm with errors of lengths (3,) and gains (3,)."""
    conditions = ArmConditions(readings)
    causes = [JointGain(joint) for joint in range(JOINTS)]
    true = ArmModel(conditions).with_causes(causes)
    shared = np.append(lengths, np.zeros(JOINTS))
    true.set_effects(shared, [Effect(cause, np.array([gain])) for cause, gain in zip(causes, gains, strict=True)])
    points = true.points(shared, np.zeros((len(readings), 0)))
    covariance = np.broadcast_to(NOISE_M**2 * np.eye(3), (*points.shape, 3))
    measured = Observations(
        points + NOISE_M * rng.normal(size=points.shape), covariance, np.ones(points.shape[:2], bool)
    )
    frames = Frames(np.tile(np.eye(3), (len(readings), 1, 1)), np.zeros((len(readings), 3)), free=False)
    return Epochs(measured, conditions, frames)


def searched(calibration: Epochs, held_out: Epochs | None) -> CauseDiagnosis:
    model = ArmModel(calibration.conditions)
    return CauseSelection(model, calibration, held_out, Settings(0.05, 200, 1)).run([JointGain()])


def of_two_gains(elsewhere: Sequence[float] = (1e-4, 3e-4, 0.0)) -> CauseDiagnosis:
    """Diagnosis of a campaign with two gains; ``elsewhere``: gains (3,) in held-out epochs."""
    rng = np.random.default_rng(4)
    lengths = rng.normal(size=JOINTS)
    both = (
        epochs_of(rng.uniform(-1.0, 1.0, (count, JOINTS)), lengths, gains, rng)
        for count, gains in ((POSES, (1e-4, 3e-4, 0.0)), (POSES // 2, elsewhere))
    )
    return searched(*both)


def found_in(stated: CauseDiagnosis) -> set[str]:
    return {cause.subject for cause in stated.final.causes}


def test_a_gain_of_one_joint_is_found_and_named() -> None:
    found = [verdict for verdict in diagnosed(2e-4).verdicts if verdict.verdict == "found"]
    assert [(verdict.cause.id, verdict.cause.subject) for verdict in found] == [("joint-gain", "joint2")]


def test_nothing_is_found_in_an_arm_as_designed() -> None:
    assert not [verdict for verdict in diagnosed(0.0).verdicts if verdict.verdict == "found"]


def test_a_search_says_that_it_came_to_its_end() -> None:
    end = diagnosed(2e-4).end
    assert (end.end, end.accepted, end.left) == (SearchEnd.COMPLETE, 1, None)
    assert end.p_value > Settings(0.05, 200, 1).level


def test_a_search_that_was_ended_says_so_and_what_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("truing.inference.search_end.MANY_CAUSES", 0)
    monkeypatch.setattr("truing.inference.search_end.MOST_OPERATIONS", 0.0)
    reported = diagnosed(2e-4)
    assert reported.end.left is not None
    assert (reported.end.end, reported.end.accepted, reported.end.left.subject) == (SearchEnd.TIME, 0, "joint2")
    assert reported.end.p_value < Settings(0.05, 200, 1).level
    assert [(verdict.verdict, verdict.reason) for verdict in reported.verdicts] == [("rejected", Reason.ENDED)]
    table = adequacy_table(reported, Settings(0.05, 200, 1), "point").to_pylist()
    (row,) = [row for row in table if row["test"] == "causes-left"]
    assert (row["state"], row["search_end"], row["value"]) == ("fails", "time", 0.0)
    assert (row["left_cause"], row["left_subject"]) == ("joint-gain", "joint2")


def test_a_search_without_real_candidates_is_complete_beyond_the_limit_of_causes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("truing.inference.search_end.MANY_CAUSES", 1)
    assert diagnosed(2e-4).end.is_complete


def test_beyond_many_causes_one_that_predicts_held_out_epochs_better_is_accepted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("truing.inference.search_end.MANY_CAUSES", 1)
    reported = of_two_gains()
    assert found_in(reported) == {"joint1", "joint2"}
    # So many causes are doubted, although no other one is significant.
    assert (reported.end.end, reported.end.accepted, reported.end.left) == (SearchEnd.MOST_CAUSES, 2, None)
    assert reported.end.p_value > Settings(0.05, 200, 1).level


def test_beyond_many_causes_one_that_predicts_held_out_epochs_no_better_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("truing.inference.search_end.MANY_CAUSES", 1)
    reported = of_two_gains(elsewhere=(0.5e-4, 3e-4, 0.0))  # predicted as badly with half the gain as without
    assert found_in(reported) == {"joint2"}
    assert reported.end.left is not None
    assert (reported.end.end, reported.end.accepted, reported.end.left.subject) == (SearchEnd.MOST_CAUSES, 1, "joint1")


def test_the_numbers_of_an_accepted_cause_are_those_of_the_round_that_accepted_it() -> None:
    reported = of_two_gains()
    found = [verdict for verdict in reported.verdicts if verdict.verdict == "found"]
    assert len(found) == 2
    for own, verdict in zip(reported.rounds, found, strict=False):
        candidate = own.best[verdict.cause.id]
        assert candidate.cause.subject == verdict.cause.subject
        assert verdict.p_value == own.p_value(candidate)
        assert verdict.log_odds == own.posterior(candidate)
        assert verdict.signal_to_noise == own.scores[candidate.key].signal_to_noise
        assert verdict.candidates == own.tried


def test_released_intermediate_results_are_recomputed_identically() -> None:
    final = of_two_gains().final
    errors = final.held_out, final.error
    before = final.fit.whitened.rest, final.pathways.gram, *(error.linearised.by_shared for error in errors)
    final.release()
    assert not {"whitened", "pathways"} & (final.fit.__dict__.keys() | final.__dict__.keys())
    after = final.fit.whitened.rest, final.pathways.gram, *(error.linearised.by_shared for error in errors)
    for one, other in zip(before, after, strict=True):
        assert one is not other
        np.testing.assert_array_equal(one, other)


def test_derivatives_are_those_of_the_points() -> None:
    model = ArmModel(ArmConditions(np.random.default_rng(1).uniform(-1, 1, (5, JOINTS)))).with_causes([JointGain(2)])
    shared, none = 0.1 * np.ones(model.shared_size), np.zeros((5, 0))
    slopes = model.predict(shared, none).by_shared
    for j, step in enumerate(1e-5 * np.eye(model.shared_size)):
        ahead, behind = (model.points(shared + sign * step, none) for sign in (1.0, -1.0))
        assert_close(slopes[..., j], (ahead - behind) / 2e-5, atol=1e-9)
