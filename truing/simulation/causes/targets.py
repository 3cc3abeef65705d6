"""Targets that are not where their label says: one that was moved from some pose on, two that were exchanged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Kind, Parameter, Profiles, Scene, Step, Told
from truing.simulation.chain import State
from truing.simulation.legs import Change

ORDER = "order"
# A target is called moved where it was seen this often before and after.
FEWEST = 3
# Onsets that are tried: in a long campaign, one in some poses.
_MOST_ONSETS = 200
_PLAUSIBLE_M = 1e-4
_MM = 1e-3


@dataclass(frozen=True)
class TargetMoved(Cause):
    """A target sits elsewhere from the pose ``from_pose`` on, whose rank in time is ``from_order``."""

    body: str = ""
    target: str = ""
    from_pose: int | str = ""
    from_order: float = -np.inf

    id = "target-moved"
    step = Step.STRUCTURE
    kind = Kind.SHAPED
    reach = 1e5  # a target that is used again elsewhere moves by metres
    lasts = False
    reads = frozenset()

    @property
    def subject(self) -> str:
        """Return the target."""
        return f"target {self.target}"

    @property
    def says(self) -> str:
        """Return what happened to the target."""
        return f"target {self.target} on {self.body} sits elsewhere from pose {self.from_pose} on"

    @property
    def confirm(self) -> str:
        """Return what to do to confirm it."""
        return (
            f"Look whether target {self.target} on {self.body} is loose or was touched, and survey {self.body} again."
        )

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return none: they are told by profiles."""
        return ()

    def profiles(self, scene: Scene) -> Sequence[Profiles]:
        """Return every target from every pose on that has three poses with it on either side, and since the survey."""
        if ORDER not in scene.covariates or not len(scene.shape) or len(scene.poses) < FEWEST:
            return ()
        order = scene.covariates[ORDER]
        in_time = np.argsort(order, kind="stable")
        onsets = [0, *range(FEWEST, len(order) - FEWEST + 1, 1 + len(order) // _MOST_ONSETS)]
        late = np.stack([order >= order[in_time[onset]] for onset in onsets])

        def member(target: int, onset: int) -> Cause:
            pose = int(in_time[onsets[onset]])
            own = scene.targets
            return TargetMoved(own.bodies[target], own.names[target], scene.poses[pose], float(order[pose]))

        usable = _usable(onsets, in_time, scene)
        return [Profiles(late[..., None].astype(float), np.arange(len(scene.shape)), usable, _PLAUSIBLE_M, member)]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the shift dx, dy, dz in the frame of the body's survey."""
        return tuple(Parameter(f"d{axis}", "mm", _PLAUSIBLE_M, _MM) for axis in "xyz")

    def change(self, state: State, values: NDArray) -> Change:
        """Return d moved / d shift: one, at the target, from the pose on."""
        place = place_of(state, self.body, self.target)
        if place is None:
            return Change({}, 3)
        moved = np.zeros((len(state.rho), len(state.shape), 3, 3))
        moved[np.asarray(state.covariates[ORDER]) >= self.from_order, place] = np.eye(3)
        return Change({"moved": moved}, 3)

    def told(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[Told, ...]:
        """Return the shift, and the pose from which on."""
        return (*super().told(values, covariance, legs), Told("from_pose", self.from_pose, None, ""))


@dataclass(frozen=True)
class TargetsSwapped(Cause):
    """Two labels of a body are exchanged in ``poses``, whose ranks in time are ``orders``."""

    body: str = ""
    targets: tuple[str, ...] = ()
    poses: tuple[int | str, ...] = ()
    orders: tuple[float, ...] = ()

    id = "targets-swapped"
    step = Step.INSTRUMENT
    kind = Kind.DISCRETE
    lasts = False
    reads = frozenset()

    @property
    def subject(self) -> str:
        """Return the two targets."""
        return f"targets {' '.join(self.targets)}"

    @property
    def says(self) -> str:
        """Return what happened to the labels."""
        poses = ("pose " if len(self.poses) == 1 else "poses ") + ", ".join(str(pose) for pose in self.poses)
        return f"targets {' and '.join(self.targets)} on {self.body} bear each other's label in {poses}"

    @property
    def confirm(self) -> str:
        """Return what to do to confirm it."""
        return f"Look at the images of the poses named: which of {' and '.join(self.targets)} is which?"

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return none: exchanged labels are found among the measured points, before anything is fitted."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return none: labels are exchanged or not."""
        return ()

    def change(self, state: State, values: NDArray) -> Change:
        """Return no derivative."""
        return Change({}, 0)

    def shift(self, state: State, values: NDArray) -> dict[str, NDArray]:
        """Return how far the points of the two labels lie from where they would be without the exchange."""
        return {"points": self.recorded(state.points, state, values) - state.points}

    def recorded(self, points: NDArray, state: State, values: NDArray) -> NDArray:
        """Return points, or their motions, (B, K, 3, ...), under each other's label."""
        found = [place_of(state, self.body, target) for target in self.targets]
        places = [place for place in found if place is not None]
        if len(places) != 2:
            return points
        rows = np.flatnonzero(np.isin(state.covariates[ORDER], self.orders))[:, None]
        exchanged = points.copy()
        exchanged[rows, np.array(places)] = points[rows, np.array(places[::-1])]
        return exchanged

    def told(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[Told, ...]:
        """Return the poses, as text."""
        return (Told("poses", " ".join(str(pose) for pose in self.poses), None, ""),)


def place_of(state: State, body: str, target: str) -> int | None:
    """Return where a target stands among the state's; none where it is not there."""
    known = () if state.targets is None else tuple(zip(state.targets.bodies, state.targets.names, strict=True))
    return known.index((body, target)) if (body, target) in known else None


def _usable(onsets: Sequence[int], in_time: NDArray, scene: Scene) -> NDArray:
    """Return, for each onset and target (S, K), whether the target was seen three times on either side, and in the
    pose itself; the first onset needs no other side."""
    seen = np.ones((len(in_time), len(scene.shape)), bool) if scene.seen is None else scene.seen
    until = np.concatenate([np.zeros((1, seen.shape[1]), int), np.cumsum(seen[in_time], 0)])
    before = until[list(onsets)]
    enough = (before >= FEWEST) & (until[-1] - before >= FEWEST) & seen[in_time[list(onsets)]]
    enough[0] = until[-1] >= FEWEST
    return enough
