"""Class `RayModel`: rays of each pose, reduced to their information on common parameters, with exact derivatives.

Channels have dimension one and unit noise, and take the place of targets.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.effects_model import ChannelModel, Prediction
from truing.simulation.photographs.causes.ray_causes import RayCause, RayScene
from truing.simulation.photographs.ray_poses import RayPoses

# Prior sigma of an unknown parameter, in units of its scale: the adjustment already gives a good estimate.
_WIDE = 30.0


@dataclass(frozen=True)
class RayModel(ChannelModel[RayCause]):
    """Cameras, scale bars and air that are constant over all poses, except for a set of effects.

    ``common`` are the indices of uncertain parameters that all poses share.
    """

    conditions: RayPoses
    common: tuple[int, ...]

    channel_word = "rays of"

    @classmethod
    def of(cls, rays: RayPoses) -> Self:
        """Return the model of some poses, with all estimated common parameters as unknowns."""
        return cls(rays, tuple(n for n, p in enumerate(rays.parameters) if p.sigma != 0.0 and rays.determinable[n]))

    @cached_property
    def _common(self) -> NDArray:
        return np.array(self.common, int)

    @cached_property
    def _common_sigma(self) -> NDArray:
        """Prior sigma of each common parameter, in units of its scale."""
        parameters = [self.conditions.parameters[n] for n in self._common]
        return np.array([_WIDE if p.sigma is None else p.sigma / p.scale for p in parameters])

    @property
    def _sizes(self) -> dict[str, int]:
        return {"common": len(self._common)}

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Ray parameter (K,) of each channel."""
        return self.conditions.channels

    @property
    def channel_kinds(self) -> tuple[str, ...]:
        """Sort (K,) of the channels: ``rays``."""
        return ("rays",) * len(self.conditions.channels)

    @property
    def blocks(self) -> NDArray:
        """Ranks (B,) of the poses in time: any pose can be left out of a fit."""
        return self.conditions.rank

    @property
    def scene(self) -> RayScene:
        """Scene from which causes propose candidates."""
        return RayScene(self.conditions)

    def at(self, conditions: RayPoses) -> Self:
        """Return the model at other poses."""
        return replace(self, conditions=conditions)

    def rescaled(self, readings: float, survey: float) -> Self:
        """Return the model unchanged: it has neither readings nor a survey."""
        return self

    def offsets(self, shared: NDArray) -> NDArray:
        """Return the deviation of each ray parameter (B, T), SI, from its value in the adjustment, pose by pose."""
        rays = self.conditions
        offset = np.zeros((len(rays.poses), len(rays.parameters)), np.result_type(shared, float))
        mean = np.array([rays.parameters[n].mean for n in self._common])
        offset[:, self._common] = mean + shared[self.layout["common"]] * self._common_sigma * self._scale[self._common]
        for effect in self.effects(shared):
            offset = offset + effect.cause.moved(rays, effect.values)
        return offset

    def by_shared(self, shared: NDArray) -> NDArray:
        """Return the derivatives (B, T, G) of the offsets, in units of each parameter's scale, by the shared
        unknowns."""
        rays = self.conditions
        derivative = np.zeros((len(rays.poses), len(rays.parameters), self.shared_size))
        index = np.arange(self.layout["common"].start, self.layout["common"].stop)
        derivative[:, self._common, index] = self._common_sigma
        self._fill_effects(derivative, shared, self._number_slopes)
        return derivative

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return channels and derivatives at shared (G,) unknowns; derivatives on request."""
        root = self.conditions.root
        channels = np.einsum("bkt,bt->bk", root, self.offsets(shared) / self._scale)[..., None]
        slopes = (root @ self.by_shared(shared))[:, :, None] if by_shared else None
        return self._prediction(shared, channels, slopes, np.zeros((*channels.shape, 0)))

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the predicted channels (B, K, 1), in units of their noise."""
        return self.predict(shared, local, by_shared=False).values

    def _slopes_at(self, shared: NDArray, local: NDArray) -> Callable[[RayCause, NDArray], NDArray]:
        return lambda cause, values: np.asarray(self.conditions.root @ self._number_slopes(cause, values))

    @property
    def _scale(self) -> NDArray:
        return np.array([p.scale for p in self.conditions.parameters])

    @property
    def _shared_known(self) -> NDArray:
        known = np.zeros(self.shared_size, bool)
        known[self.layout["common"]] = [self.conditions.parameters[n].sigma is not None for n in self._common]
        return known

    def _number_slopes(self, cause: RayCause, values: NDArray) -> NDArray:
        """Return the derivatives (B, T, P) of ray parameters, in units of their scale, by a cause's parameters at
        values (P,), SI."""
        return cause.slopes(self.conditions, values) / self._scale[:, None]
