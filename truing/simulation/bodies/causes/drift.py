"""Cause: drift of a body with time, continuous, from some time on, or as a jump at one pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import Onsets, onsets_in_time
from truing.simulation.bodies.causes.deformation import BodyCause, bodies_of, is_large, whole_body_options
from truing.simulation.bodies.causes.terms import runs_with_time
from truing.simulation.cause import Parameter, ReportedParameter
from truing.simulation.change import Change
from truing.simulation.inputs import ORDER, TIME
from truing.simulation.mechanisms.causes.targets import FEWEST_POSES
from truing.simulation.mechanisms.point_causes import PointScene
from truing.simulation.mechanisms.state import State
from truing.simulation.settling import settling

# Time constants of the candidates, relative to the duration of the campaign.
_TAUS = (0.03, 0.1, 0.3, 1.0)
# Largest number of half periods of slow waves over the campaign, and least number of poses per half period.
_WAVES, _POSES_PER_WAVE = 6, 25
# Starts of a late drift, relative to the duration of the campaign.
_STARTS = (0.2, 0.35, 0.5, 0.65, 0.8)
# Largest number of onsets for a jump of the whole body, and of its shape; largest number of targets for the latter.
_MOST_ONSETS, _MOST_OF_SHAPE, _MOST_JUMPING = 60, 20, 12
_SHARE_OF_WAVES, _SHARE_OF_STARTS = 0.5, 0.5
# Limits of the log of the ratio of time constants: beyond them, a drift is a line or a step.
_LOG_RATIOS = (-4.0, 4.0)


@dataclass(frozen=True)
class BodyDrift(BodyCause):
    """A body drifts with time: its targets shift by a pattern or, if it should stand still, it moves as a whole.

    ``column`` (time_s, or the order of the poses) runs from ``start`` over ``span``, before which nothing moves. The
    drift is linear, follows 1 - exp(-t / tau), or is a sum of slow ``waves``. If ``tau_is_fitted``, the last parameter
    is the logarithm of the time constant over ``tau``. A jump displaces the body from the pose ``from_pose`` on, whose
    rank in time is ``from_order``.
    """

    column: str = TIME
    start: float = 0.0
    span: float = 1.0
    tau: float = 0.0
    waves: int = 0
    tau_is_fitted: bool = False
    late: bool = False  # whether ``start`` is after the start of the campaign
    from_pose: int | str = ""
    from_order: float = -np.inf

    id = "body-drift"
    share = 0.5  # if a drive moved in one direction only, the drive is the more probable input

    @property
    def jumps(self) -> bool:
        """True if it is a jump from one pose to the next."""
        return bool(np.isfinite(self.from_order))

    @property
    def key(self) -> str:
        """Unique name of the candidate."""
        form = f"{self.waves} waves" if self.waves else f"tau={self.tau:.6g}" if self.tau else "linear"
        return f"{self.family} {f'{form} from {self.start:.6g}' if self.late else form}"

    @property
    def family(self) -> str:
        """Body and pattern: a model holds at most one continuous drift of them, and each jump once."""
        whose = f"{self.id} {self.body} {'whole' if self.whole else 'pattern'} {self.column}"
        return f"{whose} jump at {self.from_order:.6g}" if self.jumps else whose

    def candidates(self, scene: PointScene) -> Sequence[BodyDrift]:
        """Return every body with every form of drift; as a whole only if it should stand still.

        None if a drive changed nearly linearly with time: such an effect is attributed to the drive.
        """
        column = TIME if scene.varies(TIME) else ORDER
        if scene.legs or not scene.varies(column) or any(runs_with_time(scene, (d,)) for d in scene.drives):
            return ()
        return [
            form
            for body in bodies_of(scene)
            for whole_body_option in whole_body_options(scene, body[0])
            for form in _forms(BodyDrift(*body, whole_body_option, column), scene)
        ]

    def prior(self, scene: PointScene) -> float:
        """Return the share of this form: linear, with any time constant, and as a jump at any pose are equally
        probable.

        Waves and a late start are less probable.
        """
        if self.jumps:
            return 1.0 / len(_onsets(len(scene.poses), self.whole))
        if self.late:
            return _SHARE_OF_STARTS / len(_STARTS)
        return _SHARE_OF_WAVES if self.waves else 1.0 / len(_TAUS) if self.tau else 1.0

    def onsets(self, scene: PointScene) -> Onsets[BodyDrift] | None:
        """Return, for a jump, every pose with some poses before it and from it on."""
        if not self.jumps:
            return None
        order, spacing = np.asarray(scene.covariates[ORDER]), _onsets(len(scene.poses), self.whole).step

        def begun_at(pose: int) -> BodyDrift:
            return replace(self, from_pose=scene.poses[pose], from_order=float(order[pose]))

        return onsets_in_time(order, FEWEST_POSES, spacing, self.from_order, begun_at)

    def refined(self) -> Self:
        """Return the form with a fitted time constant."""
        return replace(self, tau_is_fitted=True) if self.tau else self

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the drift from the first to the last pose, of each target or of the whole body; then tau."""
        if self.waves:
            return tuple(
                parameter for n in range(self.waves) for parameter in self._pattern_parameters(f"_wave{n + 1}")
            )
        return (*self._pattern_parameters(), *((Parameter("tau", "1", 1.0),) if self.tau_is_fitted else ()))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d moved / d drift, and the derivative by the time constant."""
        if self.waves:
            x = (np.asarray(state.covariates[self.column]) - self.start) / self.span
            functions = (np.cos(np.pi * x[:, None] * np.arange(1, self.waves + 1)) - 1.0) / 2.0
            return Change({"moved": self._derivative_of_moved(state, functions)}, self.waves * self._pattern.shape[1])
        size = self._pattern.shape[1]
        if self.jumps:
            late = np.asarray(state.covariates[ORDER]) >= self.from_order
            return Change({"moved": self._derivative_of_moved(state, late[:, None].astype(float))}, size)
        value, slope = self._course(state, values[size] if self.tau_is_fitted else 0.0)
        moved = self._derivative_of_moved(state, value[:, None])
        if self.tau_is_fitted:
            by_tau = self._derivative_of_moved(state, slope[:, None]) @ values[:size]
            moved = np.concatenate([moved, by_tau[..., None]], -1)
        return Change({"moved": moved}, moved.shape[-1])

    def shift(self, state: State, values: NDArray) -> dict[str, NDArray]:
        """Return the drift (B, K, 3) of the targets."""
        if not self.tau_is_fitted:
            return super().shift(state, values)
        size = self._pattern.shape[1]
        return {"moved": self.change(state, values).fields["moved"][..., :size] @ values[:size]}

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the drift from the first to the last pose, and the time constant in units of its column."""
        size, plain = self._pattern.shape[1], replace(self, tau_is_fitted=False, waves=0)
        to_last_pose = np.kron(np.arange(1, self.waves + 1) % 2 * -1.0, np.eye(size)) if self.waves else np.eye(size)
        end = (
            to_last_pose @ values[: to_last_pose.shape[1]],
            to_last_pose @ covariance[: to_last_pose.shape[1], : to_last_pose.shape[1]] @ to_last_pose.T,
        )
        parameters = super(BodyDrift, plain).reported(*self._free_of_motion(*end), legs)
        if self.jumps:
            return (*parameters, ReportedParameter("from_pose", self.from_pose, None, ""))
        if not self.tau_is_fitted:
            return parameters
        tau = self.tau * float(np.exp(np.clip(values[size], *_LOG_RATIOS)))
        unit = "s" if self.column == TIME else "poses"
        return (*parameters, ReportedParameter("tau", tau, tau * float(np.sqrt(covariance[size, size])), unit))

    def _course(self, state: State, log_ratio: Any) -> tuple[NDArray, NDArray]:
        """Return the course of the drift (B,), 0 at the start and 1 at the end, and its derivative by the log of
        tau."""
        x = (np.asarray(state.covariates[self.column]) - self.start) / self.span
        if not self.tau:
            return (np.maximum(x, 0.0) if self.late else x), np.zeros_like(x)
        bounded = sorted((*_LOG_RATIOS, log_ratio), key=np.real)[1]
        return settling(x, self.span / self.tau * np.exp(-bounded))


def _forms(body_drift: BodyDrift, scene: PointScene) -> list[BodyDrift]:
    """Return the forms of drift of a body; only a linear one for the shape of a body with many targets."""
    start, end = _time_range(scene, body_drift.column)
    body_drift = replace(body_drift, start=start, span=end - start)
    waves = min(_WAVES, len(scene.poses) // _POSES_PER_WAVE)
    forms = [body_drift]
    if body_drift.whole or not is_large(body_drift.targets):
        forms += [replace(body_drift, tau=tau * body_drift.span) for tau in _TAUS]
        forms += [
            replace(body_drift, start=start + s * body_drift.span, span=(1.0 - s) * body_drift.span, late=True)
            for s in _STARTS
        ]
        forms += [replace(body_drift, waves=waves)] if waves > 1 else []
    if (body_drift.whole or len(body_drift.targets) <= _MOST_JUMPING) and ORDER in scene.covariates:
        order = np.asarray(scene.covariates[ORDER])
        in_time = np.argsort(order, kind="stable")
        at = [int(in_time[onset]) for onset in _onsets(len(order), body_drift.whole)]
        forms += [replace(body_drift, from_pose=scene.poses[pose], from_order=float(order[pose])) for pose in at]
    return forms


def _onsets(poses: int, whole_campaign: bool) -> range:
    """Return the ranks in time of possible jumps: with three poses on either side."""
    most = _MOST_ONSETS if whole_campaign else _MOST_OF_SHAPE
    return range(FEWEST_POSES, poses - FEWEST_POSES + 1, -(-poses // most))


def _time_range(scene: PointScene, column: str) -> tuple[float, float]:
    """Return the first and the last time of the campaign."""
    if column == TIME and scene.span_s is not None:
        return scene.span_s
    values = scene.covariates[column]
    return float(values.min()), float(values.max())
