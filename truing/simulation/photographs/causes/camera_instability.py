"""Cause: unstable interior orientation of a camera, which changes between poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, ReportedParameter
from truing.simulation.inputs import TEMPERATURE, TIME
from truing.simulation.photographs.causes.ray_causes import FEWEST_POSES, RayCause, RayScene, at_numbers
from truing.simulation.photographs.ray_poses import CAMERA, RayPoses
from truing.simulation.settling import reported_time_constant, settling

JUMP, DRIFT, SETTLES, WARMTH, SCATTER = "jump", "drift", "settles", "temperature", "scatter"
PRINCIPAL_DISTANCE, PRINCIPAL_POINT = ("c",), ("x0", "y0")
_WHAT = (PRINCIPAL_DISTANCE, PRINCIPAL_POINT, ("x0",), ("y0",), (*PRINCIPAL_DISTANCE, *PRINCIPAL_POINT))
_SHARE_OF_WHAT = (0.4, 0.2, 0.1, 0.1, 0.2)
_SHARE_OF_FORM = {JUMP: 0.25, DRIFT: 0.15, SETTLES: 0.1, WARMTH: 0.25, SCATTER: 0.25}
_PLAUSIBLE_PX, _PLAUSIBLE_PX_PER_K = 1.0, 0.3
# Time constants of the candidates, relative to the duration of the campaign.
_SETTLING = (0.5, 0.25, 0.125, 0.0625)
# Prior sigma of the log of the time constant about that of the candidate.
_PLAUSIBLE_LOG = 0.5
# Largest number of poses for independent changes.
_MOST_APART = 60


@dataclass(frozen=True)
class CameraInstability(RayCause):
    """The principal distance (c), the principal point (x0, y0), or both, of a camera change between poses.

    ``form``: a jump at the pose of time rank ``since`` (``from_pose``); a linear drift with time from ``start_s`` over
    ``duration_s``; an exponential one with time constant ``tau_s``; proportional to temperature; an independent change
    in each of ``poses``. If ``free``, the logarithm of tau over ``tau_s`` is a further parameter.
    """

    camera: str = ""
    what: tuple[str, ...] = PRINCIPAL_DISTANCE
    form: str = JUMP
    since: float = 0.0
    from_pose: int | str = ""
    start_s: float = 0.0
    duration_s: float = 1.0
    tau_s: float = 0.0
    free: bool = False
    poses: tuple[int | str, ...] = ()

    id = "camera-instability"
    reach = 30.0
    is_persistent = False

    @property
    def subject(self) -> str:
        """Camera concerned."""
        return f"{CAMERA} {self.camera}"

    @property
    def key(self) -> str:
        """Unique name of the candidate."""
        shape = {JUMP: f" {self.from_pose}", SETTLES: f" {self.tau_s:.6g}"}.get(self.form, "")
        return f"{self.family} {self.form}{shape}"

    @property
    def family(self) -> str:
        """Camera, and the parameters that change."""
        return f"{self.id} {self.camera} {' '.join(self.what)}"

    def excludes(self, other: RayCause) -> bool:
        """True if the other has the same course in the same camera; a camera may both jump and drift."""
        if not isinstance(other, CameraInstability) or self.camera != other.camera:
            return False
        shared = bool(set(self.what) & set(other.what))
        alike = self.form == other.form or {self.form, other.form} == {DRIFT, SETTLES}
        return shared and alike and (self.form != JUMP or self.from_pose == other.from_pose)

    def candidates(self, scene: RayScene) -> Sequence[CameraInstability]:
        """Return every form of every camera for which there are poses and columns."""
        rays = scene.rays
        return [
            form
            for camera in rays.owners(CAMERA)
            for what in _WHAT
            for form in _forms(CameraInstability(camera, what), rays)
        ]

    def prior(self, scene: RayScene) -> float:
        """Return the share of this form and of the changing parameters; all jumps together have one share."""
        rays = scene.rays
        forms = {JUMP: len(_onsets(rays, self.camera)), SETTLES: len(_SETTLING)}
        of_what = _SHARE_OF_WHAT[_WHAT.index(self.what)]
        return of_what * _SHARE_OF_FORM[self.form] / max(forms.get(self.form, 1), 1)

    def covers(self, covariates: Mapping[str, NDArray], poses: int) -> NDArray:
        """Return the mask (B,) of poses where the cause is valid; none for independent changes, which predict no
        other pose."""
        return np.full(poses, self.form != SCATTER)

    def refined(self) -> Self:
        """Return the form with a fitted time constant; other forms unchanged."""
        return replace(self, free=True) if self.form == SETTLES else self

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: a camera does not move the machine."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the change of each camera parameter: by the jump, over the campaign, per kelvin, or in every pose."""
        if self.form == WARMTH:
            return tuple(Parameter(f"{name}_per_k", "px/K", _PLAUSIBLE_PX_PER_K) for name in self.what)
        if self.form == SCATTER:
            return tuple(
                Parameter(f"{name}_pose_{pose}", "px", _PLAUSIBLE_PX) for name in self.what for pose in self.poses
            )
        parameters_of_jump = tuple(Parameter(name, "px", _PLAUSIBLE_PX) for name in self.what)
        return (*parameters_of_jump, Parameter("log_tau", "1", _PLAUSIBLE_LOG)) if self.free else parameters_of_jump

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the changes, then the pose of a jump or the time constant; for independent changes their scatter."""
        if self.form == SCATTER:
            return tuple(self._scatter(values, covariance))
        reported_values = super().reported(values, covariance, legs)
        if self.form == JUMP:
            return (
                (*reported_values, ReportedParameter("from_pose", self.from_pose, None, ""))
                if self.from_pose != ""
                else reported_values
            )
        if self.form != SETTLES:
            return reported_values
        if not self.free:
            return (*reported_values, ReportedParameter("tau", self.tau_s, None, "s"))
        return (*reported_values[:-1], reported_time_constant(self.tau_s, values[-1], covariance[-1, -1]))

    def slopes(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return the derivatives of the camera parameters: the course, or one per pose."""
        indices = rays.places(CAMERA, self.camera, self.what)
        if self.form == SCATTER:
            return self._independent_changes(rays, indices)
        course, by_log = self._course(rays, values)
        derivative = at_numbers(rays, indices, course)
        if self.free:
            bent = at_numbers(rays, indices, by_log) @ values[:-1]
            derivative = np.concatenate([derivative, bent[..., None]], -1)
        return derivative

    def moved(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return the errors (B, T) of the parameters, px."""
        slopes = self.slopes(rays, values)
        return np.asarray(slopes[..., :-1] @ values[:-1] if self.free else slopes @ values)

    def _course(self, rays: RayPoses, values: NDArray) -> tuple[NDArray, NDArray]:
        """Return the course (B,) of the change, and its derivative by the logarithm of tau."""
        if self.form == WARMTH:
            return rays.temperature_rise, np.zeros(len(rays.poses))
        if self.form == JUMP:
            return (rays.covariates["order"] >= self.since).astype(float), np.zeros(len(rays.poses))
        passed = (rays.covariates[TIME] - self.start_s) / self.duration_s
        if self.form == DRIFT:
            return passed, np.zeros_like(passed)
        rate = self.duration_s / self.tau_s * np.exp(-values[-1] if self.free else 0.0)
        return settling(passed, rate)

    def _independent_changes(self, rays: RayPoses, indices: list[int]) -> NDArray:
        """Return the slopes of independent changes in each pose; zero in other poses."""
        at = {pose: n for n, pose in enumerate(self.poses)}
        place_of_pose = np.array([at.get(pose, -1) for pose in rays.poses])
        derivative = np.zeros((len(place_of_pose), len(rays.parameters), len(indices), len(self.poses)))
        for number, index in enumerate(indices):
            derivative[place_of_pose >= 0, index, number, place_of_pose[place_of_pose >= 0]] = 1.0
        return derivative.reshape(len(place_of_pose), len(rays.parameters), -1)

    def _scatter(self, values: NDArray, covariance: NDArray) -> list[ReportedParameter]:
        """Return the scatter of each camera parameter about its mean, without its noise, and one sigma of it."""
        count, parameters = len(self.poses), []
        for number, name in enumerate(self.what):
            numbers = slice(number * count, (number + 1) * count)
            centring = np.eye(count) - 1.0 / count
            noise = centring @ covariance[numbers, numbers] @ centring
            freedom = max(count - 1.0, 1.0)
            square = float(np.sum((centring @ values[numbers]) ** 2))
            variance = max((square - float(np.trace(noise))) / freedom, 0.0)
            spread = variance * centring + noise
            sigma = float(np.sqrt(2.0 * np.sum(spread * spread))) / freedom  # sigma of the variance
            size = float(np.sqrt(variance))
            parameters.append(
                ReportedParameter(f"{name}_scatter", size, sigma / (2.0 * max(size, 0.5 * np.sqrt(sigma))), "px")
            )
        return parameters


def _onsets(rays: RayPoses, camera: str) -> list[int]:
    """Return the poses at which a camera may jump: with enough of its poses on either side."""
    indices = np.flatnonzero(rays.poses_of(CAMERA, camera))
    in_time = indices[np.argsort(rays.rank[indices], kind="stable")]
    return in_time[FEWEST_POSES : len(in_time) - FEWEST_POSES + 1].tolist() if len(in_time) >= 2 * FEWEST_POSES else []


def _forms(plain: CameraInstability, rays: RayPoses) -> list[CameraInstability]:
    """Return the forms for which a campaign has poses and columns."""
    forms = [
        replace(plain, form=JUMP, since=float(rays.covariates["order"][row]), from_pose=rays.poses[row])
        for row in _onsets(rays, plain.camera)
    ]
    if rays.span_s is not None and rays.varies(TIME):
        start, duration = rays.span_s[0], rays.span_s[1] - rays.span_s[0]
        timed = replace(plain, form=DRIFT, start_s=start, duration_s=duration)
        forms += [timed, *(replace(timed, form=SETTLES, tau_s=share * duration) for share in _SETTLING)]
    if rays.varies(TEMPERATURE):
        forms.append(replace(plain, form=WARMTH))
    poses_of_camera = rays.poses_of(CAMERA, plain.camera)
    if 2 * FEWEST_POSES <= poses_of_camera.sum() <= _MOST_APART:
        forms.append(
            replace(plain, form=SCATTER, poses=tuple(rays.poses[row] for row in np.flatnonzero(poses_of_camera)))
        )
    return forms
