"""Rays of all poses, each pose's reduced to what it tells of the numbers that all poses share, with exact derivatives.

Poses are poses; channels, of one dimension and unit noise, stand for targets.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import OBSERVED, Cause, Scene
from truing.simulation.effects_model import EffectsModel, Prediction, laid_out
from truing.simulation.photographs.causes.ray_causes import RayCause
from truing.simulation.photographs.ray_poses import RayPoses
from truing.simulation.targets import Targets

# What nothing is known of beforehand: so many times its scale, for the adjustment has brought it near.
_WIDE = 30.0
_NO_BODY, _NO_LEG = 4, -1


@dataclass(frozen=True)
class RayModel(EffectsModel):
    """Cameras, scale bars and air that are the same in all poses, but for a set of effects.

    ``common`` are the numbers that an adjustment does not know exactly, though they are common to all poses.
    """

    conditions: RayPoses
    common: tuple[int, ...]

    @classmethod
    def of(cls, rays: RayPoses) -> Self:
        """Return the model of some poses, in which everything that was estimated of what they share is open."""
        return cls(rays, tuple(n for n, p in enumerate(rays.parameters) if p.sigma != 0.0 and rays.tells[n]))

    @property
    def part_count(self) -> int:
        """Return the number of legs: none."""
        return 0

    @cached_property
    def _common(self) -> NDArray:
        return np.array(self.common, int)

    @cached_property
    def _common_sigma(self) -> NDArray:
        """Return one prior sigma of each of these, in units of its scale."""
        own = [self.conditions.parameters[n] for n in self._common]
        return np.array([_WIDE if p.sigma is None else p.sigma / p.scale for p in own])

    @cached_property
    def layout(self) -> dict[str, slice]:
        """Return where each kind of shared unknown stands in the vector."""
        sizes = {"common": len(self._common), "shape": 0}
        sizes |= {cause.key: len(cause.parameters(0)) for cause in self.causes}
        return laid_out(sizes)

    @property
    def local_size(self) -> int:
        """Return the number of local unknowns: none, what is a pose's own has been eliminated."""
        return 0

    @property
    def unpredicted(self) -> NDArray:
        """Return which local unknowns the model says nothing of: none."""
        return np.zeros(0, bool)

    @property
    def channel_groups(self) -> NDArray:
        """Return the number of each channel's noise (K,): one for all, that of the rays."""
        return np.zeros(len(self.conditions.channels), int)

    @property
    def targets(self) -> Targets:
        """Return the channels as what is measured."""
        names = self.conditions.channels
        count = len(names)
        return Targets(np.full(count, _NO_BODY), np.full(count, _NO_LEG), names, ("rays",) * count)

    @property
    def blocks(self) -> NDArray:
        """Return the poses' ranks in time (B,): any can be left out together."""
        return self.conditions.rank

    @property
    def scene(self) -> Scene:
        """Return what the campaign offers to causes when they propose candidates."""
        own = self.conditions
        return Scene(
            self.targets,
            np.zeros((len(own.channels), 0)),
            own.readings,
            np.empty(0),
            own.poses,
            own.covariates,
            own.span_s,
            own.reference_temperature_c,
            rays=own,
            word_of_target="rays of",
        )

    def at(self, conditions: RayPoses) -> Self:
        """Return the model at other poses."""
        return replace(self, conditions=conditions)

    def rescaled(self, readings: float, survey: float) -> Self:
        """Return the model: it has neither readings nor a survey."""
        return self

    def offsets(self, shared: NDArray) -> NDArray:
        """Return by how much each number (B, T), SI, is off its value in the adjustment, pose by pose."""
        rays = self.conditions
        found = np.zeros((len(rays.poses), len(rays.parameters)), np.result_type(shared, float))
        mean = np.array([rays.parameters[n].mean for n in self._common])
        found[:, self._common] = mean + shared[self.layout["common"]] * self._common_sigma * self._scale[self._common]
        for effect in self.effects(shared):
            found = found + _of_rays(effect.cause).moved(rays, effect.values)
        return found

    def by_shared(self, shared: NDArray) -> NDArray:
        """Return how these offsets (B, T, G), in units of each number's scale, follow the shared unknowns."""
        rays = self.conditions
        found = np.zeros((len(rays.poses), len(rays.parameters), self.shared_size))
        place = np.arange(self.layout["common"].start, self.layout["common"].stop)
        found[:, self._common, place] = self._common_sigma
        for effect in self.effects(shared):
            slopes = _of_rays(effect.cause).slopes(rays, effect.values) / self._scale[:, None]
            found[..., self.layout[effect.cause.key]] = slopes * self.effect_sigma(effect.cause)
        return found

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return channels and derivatives at shared (G,) unknowns; by the shared ones if asked for."""
        rays = self.conditions
        channels = np.einsum("bkt,bt->bk", rays.root, self.offsets(shared) / self._scale)
        slopes = rays.root @ self.by_shared(shared) if by_shared else np.empty((*channels.shape, 0))
        return Prediction(
            channels[..., None],
            slopes[:, :, None],
            np.zeros((*channels.shape, 1, 0)),
            np.empty(0),
            np.empty((0, slopes.shape[-1])),
            self._shared_known,
            np.zeros(0, bool),
        )

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the predicted channels (B, K, 1), in units of their noise."""
        return self.predict(shared, local, by_shared=False).values

    def rotations(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return how channels follow shifts of them, (B, K, 1, 1): by one."""
        return np.ones((*self.conditions.root.shape[:2], 1, 1))

    def pathways(self, shared: NDArray, local: NDArray) -> dict[str, NDArray]:
        """Return no channel: what acts on rays is told by what it does to them."""
        return {}

    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[Cause], dict[str, NDArray]]:
        """Return what tells a cause's change of the pathway ``observed``, (B, K, P), per plausible scale."""

        def found(cause: Cause) -> dict[str, NDArray]:
            values = np.zeros(len(cause.parameters(0)))
            return {OBSERVED: self._followed(cause, values) * self.effect_scale(cause)}

        return found

    @property
    def _scale(self) -> NDArray:
        return np.array([p.scale for p in self.conditions.parameters])

    @property
    def _shared_known(self) -> NDArray:
        known = np.zeros(self.shared_size, bool)
        known[self.layout["common"]] = [self.conditions.parameters[n].sigma is not None for n in self._common]
        return known

    def _followed(self, cause: Cause, values: NDArray) -> NDArray:
        """Return how channels (B, K, P) follow a cause's parameters at values (P,), SI."""
        slopes = _of_rays(cause).slopes(self.conditions, values)
        return np.asarray(self.conditions.root @ (slopes / self._scale[:, None]))


def _of_rays(cause: Cause) -> RayCause:
    assert isinstance(cause, RayCause)
    return cause
