"""Causes on targets: a target or marker that moved at some pose, and two exchanged labels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.labels.exchanges import Exchange
from truing.estimation.rotation import exp_so3, left_jacobian_so3, skew
from truing.inference.model import CauseT, ChannelCandidates, Onsets, onsets_in_time
from truing.simulation.cause import Parameter, ReportedParameter, Step
from truing.simulation.change import Change
from truing.simulation.inputs import ORDER
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State

# Least number of poses that show a target before its displacement, and after it.
FEWEST_POSES = 3
# Largest number of onsets: in a long campaign, not every pose is tried.
_MOST_ONSETS = 200
_PLAUSIBLE_M = 1e-4
_MM = 1e-3
_OF_MARKERS = ("corners", "places")


@dataclass(frozen=True)
class TargetMoved(PointCause):
    """A target is displaced on its body from the pose ``from_pose`` on, whose rank in time is ``from_order``.

    A square marker shifts and turns as a whole: ``corners`` are its targets, ``places`` their positions on the body, m,
    flattened.
    """

    body: str = ""
    target: str = ""
    from_pose: int | str = ""
    from_order: float = -np.inf
    corners: tuple[str, ...] = ()
    places: tuple[float, ...] = ()

    id = "target-moved"
    step = Step.STRUCTURE
    reach = 1e5  # a target that is mounted again elsewhere moves by metres
    is_persistent = False
    reads = frozenset()

    @property
    def subject(self) -> str:
        """Target or marker concerned."""
        return f"{'marker' if self.corners else 'target'} {self.target}"

    def settings(self) -> dict[str, object]:
        """Return the fields; without those of markers for a target."""
        return {name: value for name, value in super().settings().items() if self.corners or name not in _OF_MARKERS}

    def candidates(self, scene: PointScene) -> Sequence[TargetMoved]:
        """Return none: `channel_candidates` has them."""
        return ()

    def channel_candidates(self, scene: PointScene) -> Sequence[ChannelCandidates[TargetMoved]]:
        """Return every target, and every marker instead of its corners, displaced from each possible pose on.

        The target must be seen at three poses before and after; a displacement since the survey is possible too.
        """
        if ORDER not in scene.covariates or not len(scene.shape) or len(scene.poses) < FEWEST_POSES:
            return ()
        order = scene.covariates[ORDER]
        in_time = np.argsort(order, kind="stable")
        onsets = [0, *range(FEWEST_POSES, len(order) - FEWEST_POSES + 1, _onset_spacing(scene))]
        late = np.stack([order >= order[in_time[onset]] for onset in onsets])[..., None].astype(float)
        usable = _usable(onsets, in_time, scene)
        targets = scene.targets
        marker_corners = markers_of(targets.bodies, targets.names) if scene.photographed else {}
        markers, corners = list(marker_corners), list(marker_corners.values())
        alone = np.setdiff1d(np.arange(len(scene.shape)), [k for of_one in corners for k in of_one])

        def moved(body: str, name: str, onset: int) -> TargetMoved:
            pose = int(in_time[onsets[onset]])
            return TargetMoved(body, name, scene.poses[pose], float(order[pose]))

        def member(target: int, onset: int) -> TargetMoved:
            return moved(targets.bodies[alone[target]], targets.names[alone[target]], onset)

        def marker(number: int, onset: int) -> TargetMoved:
            which = list(corners[number])
            return moved(*markers[number], onset).of_corners([targets.names[k] for k in which], scene.shape[which])

        single = ChannelCandidates(late, alone, usable[:, alone], _PLAUSIBLE_M, member)
        if not marker_corners:
            return [single]
        together, patterns = rigid_patterns(corners, scene.shape)
        is_observed = np.asarray(usable[:, together].all(-1))
        return [
            *([single] if len(alone) else []),
            ChannelCandidates(late, together, is_observed, _PLAUSIBLE_M, marker, patterns),
        ]

    def onsets(self, scene: PointScene) -> Onsets[TargetMoved]:
        """Return every pose with some poses before it and from it on."""
        return onsets_of_poses(
            scene, self.from_order, lambda pose, order: replace(self, from_pose=pose, from_order=order)
        )

    def of_corners(self, corners: Sequence[str], positions: NDArray) -> TargetMoved:
        """Return the cause for the marker with these corners at positions (n, 3) on the body, m."""
        return replace(self, corners=tuple(corners), places=tuple(float(x) for x in np.ravel(positions)))

    @property
    def _arms(self) -> tuple[NDArray, float]:
        return arms_of(np.reshape(self.places, (-1, 3)))

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the shift dx, dy, dz in the frame of the body's survey, and the rotation of a marker about its
        centre."""
        shift = tuple(Parameter(f"d{axis}", "mm", _PLAUSIBLE_M, _MM) for axis in "xyz")
        if not self.corners:
            return shift
        return (*shift, *(Parameter(f"turn_{axis}", "rad", _PLAUSIBLE_M / self._arms[1]) for axis in "xyz"))

    def change(self, state: State, values: NDArray) -> Change:
        """Return the derivatives of ``moved`` by the shift, and for corners by the rotation, from the pose on."""
        slope = np.eye(3)[None]
        if self.corners:
            turned = self._arms[0] @ np.swapaxes(exp_so3(values[3:]), -1, -2)
            shift = np.broadcast_to(np.eye(3), (len(turned), 3, 3))
            slope = np.concatenate([shift, -skew(turned) @ left_jacobian_so3(values[3:])], -1)
        return Change(self._moved_at_target(state, slope), slope.shape[-1])

    def shift(self, state: State, values: NDArray) -> dict[str, NDArray]:
        """Return the displacement (B, K, 3) of the targets; a marker may turn by any angle."""
        if not self.corners:
            return super().shift(state, values)
        arms = self._arms[0]
        return self._moved_at_target(state, arms @ np.swapaxes(exp_so3(values[3:]), -1, -2) - arms + values[:3])

    def _moved_at_target(self, state: State, by: NDArray) -> dict[str, NDArray]:
        """Return ``moved`` (B, K, ...), equal to ``by`` (n, ...) at the target or corners from the pose on.

        Empty if the state has none of these targets.
        """
        indices = [place_of(state, self.body, name) for name in self.corners or (self.target,)]
        if all(index is None for index in indices):
            return {}
        late = np.asarray(state.covariates[ORDER]) >= self.from_order
        moved = np.zeros((len(state.rho), len(state.shape), *by.shape[1:]), by.dtype)
        for index, derivative in zip(indices, by, strict=True):
            if index is not None:
                moved[late, index] = derivative
        return {"moved": moved}

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the shift, and the first displaced pose."""
        return (*super().reported(values, covariance, legs), ReportedParameter("from_pose", self.from_pose, None, ""))


def onset_poses(scene: PointScene) -> list[int]:
    """Return the poses from which something may have changed, in order of time: every one, or every few of a long
    campaign, with some poses before it and from it on; none where their order is unknown."""
    if ORDER not in scene.covariates or len(scene.poses) < FEWEST_POSES:
        return []
    in_time = np.argsort(scene.covariates[ORDER], kind="stable")
    return [int(pose) for pose in in_time[FEWEST_POSES : len(in_time) - FEWEST_POSES + 1 : _onset_spacing(scene)]]


def onsets_of_poses(
    scene: PointScene, from_order: float, begun_at: Callable[[int | str, float], CauseT]
) -> Onsets[CauseT]:
    """Return the onsets that a cause can have which acts from the rank ``from_order`` in time on; ``begun_at`` returns
    it from a pose and its rank on."""
    order = scene.covariates[ORDER]

    def at_pose(pose: int) -> CauseT:
        return begun_at(scene.poses[pose], float(order[pose]))

    return onsets_in_time(order, FEWEST_POSES, _onset_spacing(scene), from_order, at_pose)


def _onset_spacing(scene: PointScene) -> int:
    """Return the spacing of the onsets that are tried."""
    return 1 + len(scene.poses) // _MOST_ONSETS


@dataclass(frozen=True)
class TargetsSwapped(PointCause):
    """Two labels of a body are exchanged in ``poses``, whose ranks in time are ``orders``."""

    body: str = ""
    targets: tuple[str, ...] = ()
    poses: tuple[int | str, ...] = ()
    orders: tuple[float, ...] = ()

    id = "targets-swapped"
    step = Step.INSTRUMENT
    is_persistent = False
    reads = frozenset()

    @property
    def subject(self) -> str:
        """The two targets."""
        return f"targets {' '.join(self.targets)}"

    @property
    def concerns_several(self) -> bool:
        """True: two targets are exchanged."""
        return True

    def candidates(self, scene: PointScene) -> Sequence[TargetsSwapped]:
        """Return none: exchanged labels are found among the measured points, before any fit."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return none: the cause is discrete."""
        return ()

    def change(self, state: State, values: NDArray) -> Change:
        """Return no derivative."""
        return Change({}, 0)

    def shift(self, state: State, values: NDArray) -> dict[str, NDArray]:
        """Return the displacement of the two labels' points by the exchange."""
        return {"points": self.recorded(state.points, state, values) - state.points}

    def recorded(self, points: NDArray, state: State, values: NDArray) -> NDArray:
        """Return points, or their motions, (B, K, 3, ...), with the two labels exchanged."""
        places = [place_of(state, self.body, target) for target in self.targets]
        indices = [index for index in places if index is not None]
        if len(indices) != 2:
            return points
        rows = np.flatnonzero(np.isin(state.covariates[ORDER], self.orders))[:, None]
        exchanged = points.copy()
        exchanged[rows, np.array(indices)] = points[rows, np.array(indices[::-1])]
        return exchanged

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the poses, as text."""
        return (ReportedParameter("poses", " ".join(str(pose) for pose in self.poses), None, ""),)


def place_of(state: State, body: str, target: str) -> int | None:
    """Return the index of a target among those of the state; None if it is absent."""
    known = () if state.targets is None else tuple(zip(state.targets.bodies, state.targets.names, strict=True))
    return known.index((body, target)) if (body, target) in known else None


def _usable(onsets: Sequence[int], in_time: NDArray, scene: PointScene) -> NDArray:
    """Return the mask (S, K) of onsets and targets: seen at three poses on either side, and at the onset itself.

    The first onset needs no poses before it.
    """
    is_observed = np.ones((len(in_time), len(scene.shape)), bool) if scene.is_observed is None else scene.is_observed
    until = np.concatenate([np.zeros((1, is_observed.shape[1]), int), np.cumsum(is_observed[in_time], 0)])
    before = until[list(onsets)]
    enough = (before >= FEWEST_POSES) & (until[-1] - before >= FEWEST_POSES) & is_observed[in_time[list(onsets)]]
    enough[0] = until[-1] >= FEWEST_POSES
    return enough


# Suffixes of a marker's corners in photographs, after the marker's name and a point.
_CORNERS = frozenset("0123")
_FEWEST = 3


def markers_of(bodies: Sequence[str], names: Sequence[str]) -> dict[tuple[str, str], tuple[int, ...]]:
    """Return the corners of each marker, three or four indices among the K targets, by body and marker name.

    A marker that has all targets of its body is omitted: it moves as the body does.
    """
    marker_corners: dict[tuple[str, str], list[int]] = {}
    for number, (body, name) in enumerate(zip(bodies, names, strict=True)):
        marker, point, corner = name.rpartition(".")
        if point and corner in _CORNERS:
            marker_corners.setdefault((body, marker), []).append(number)
    return {
        key: tuple(corners)
        for key, corners in marker_corners.items()
        if _FEWEST <= len(corners) <= len(_CORNERS) and len(corners) < list(bodies).count(key[0])
    }


def arms_of(positions: NDArray) -> tuple[NDArray, float]:
    """Return the positions of corners (n, 3) relative to their centroid, and the rms of their distance from it, m."""
    arms = positions - positions.mean(0)
    return arms, float(np.sqrt(np.mean(np.sum(arms**2, -1))))


def rigid_patterns(markers: Sequence[Sequence[int]], positions: NDArray) -> tuple[NDArray, NDArray]:
    """Return the corners (T, n) of markers among positions (K, 3), m, and their rigid motions (T, n, 3, 6).

    The motions are shifts along the axes, and rotations scaled to the same rms displacement of the corners. A marker of
    three corners repeats its first, with zero motion.
    """
    corners = np.array([[*corner_numbers, *corner_numbers[:1]][: len(_CORNERS)] for corner_numbers in markers])
    patterns = np.zeros((*corners.shape, 3, 6))
    for number, marker in enumerate(markers):
        arms, radius = arms_of(positions[list(marker)])
        patterns[number, : len(marker), :, :3] = np.eye(3)
        patterns[number, : len(marker), :, 3:] = -skew(arms) / radius
    return corners, patterns


def swapped_targets(
    body: str, targets: Sequence[str], poses: Sequence[int | str], order: NDArray, exchanges: Sequence[Exchange]
) -> list[TargetsSwapped]:
    """Return one cause per pair of exchanged targets, with all poses in which they are exchanged."""
    rows: dict[tuple[int, int], list[int]] = {}
    for exchange in exchanges:
        rows.setdefault((exchange.first, exchange.second), []).append(exchange.pose)
    return [
        TargetsSwapped(
            body,
            (targets[first], targets[second]),
            tuple(poses[row] for row in rows_of_pair),
            tuple(float(order[row]) for row in rows_of_pair),
        )
        for (first, second), rows_of_pair in rows.items()
    ]
