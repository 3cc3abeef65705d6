"""A photographed campaign as a plan whose rays can be drawn again: what they told of numbers that all poses share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Effect, Scene
from truing.simulation.photographs.causes.ray_causes import RayCause
from truing.simulation.photographs.ray_poses import RayPoses
from truing.stages.common.point_arrays import positions

if TYPE_CHECKING:
    import pyarrow as pa


NEEDS = ("ray_statistics", "ray_information", "ray_effects", "configurations", "poses")


@dataclass(frozen=True)
class RayPlan:
    """The network of a run: what its rays tell of cameras, scale bars and air, and the tables that a drawn campaign
    with the same network fills with other scores.

    Rays follow these numbers linearly, with the derivatives at the run's adjustment. ``scene`` is what causes may
    propose candidates from, as the diagnosis offers it to them.
    """

    rays: RayPoses
    tables: Mapping[str, pa.Table]
    scene: Scene

    part_count = 0  # nothing is numbered by legs
    through: tuple[str, ...] = ()  # stages between what is drawn and the diagnosis

    def with_gross(self, share: float) -> RayPlan:
        """The plan as it is; raises ValueError for a share of wrong rays, which an adjustment leaves none of."""
        if share > 0:
            raise ValueError("rays that are grossly wrong are sought before causes are: --gross 0")
        return self

    def drawn(self, effects: Sequence[Effect], rng: np.random.Generator) -> dict[str, pa.Table]:
        """The tables of a campaign drawn anew with effects hidden in it."""
        rays, scale = self.rays, np.array([number.scale for number in self.rays.parameters])
        known = np.array([number.sigma or 0.0 for number in rays.parameters])
        mean = np.array([number.mean for number in rays.parameters])
        off = np.tile(np.where(known > 0.0, mean + known * rng.standard_normal(len(known)), 0.0), (len(rays.poses), 1))
        for effect in effects:
            assert isinstance(effect.cause, RayCause)
            off = off + effect.cause.moved(rays, effect.values)
        value = np.einsum("bkt,bt->bk", rays.root, off / scale) + rng.standard_normal(rays.root.shape[:2])
        return {**self.tables, "ray_statistics": self._scored(np.einsum("bkt,bk->bt", rays.root, value))}

    def _scored(self, score: NDArray) -> pa.Table:
        import pyarrow as pa

        table = self.tables["ray_statistics"]
        pose = positions(table.column("pose"), self.rays.poses)
        number = positions(table.column("shared_number"), tuple(own.called for own in self.rays.parameters))
        place = table.schema.get_field_index("score")
        return table.set_column(place, table.schema.field(place), pa.array(score[pose, number]))


def ray_plan(tables: Mapping[str, pa.Table], rays: RayPoses, scene: Scene) -> RayPlan:
    """The plan of a run's rays, as the diagnosis gathered them."""
    return RayPlan(rays, {name: tables[name] for name in NEEDS if name in tables}, scene)
