"""What causes share that act on measured points, of a mechanism or of bodies without one, and what they are offered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Effect, Scene
from truing.simulation.change import Change
from truing.simulation.mechanisms.state import LEG_FIELDS, State
from truing.simulation.mechanisms.weight import Weight
from truing.simulation.targets import Targets


@dataclass(frozen=True)
class Photographed:
    """That points come from photographs: with so many ``errors`` common to all poses (of cameras, of scale bars) and so
    many that the points of each pose share (its scale, ..), each of one standard deviation; and the bars that gave them
    their scale, and at which height in the model's frame, m."""

    errors: int = 0
    pose_errors: int = 0
    scale_bars: tuple[str, ...] = ()
    scale_height_m: float = 0.0


@dataclass(frozen=True)
class PointScene(Scene["PointCause"]):
    """What a campaign offers to causes when they propose candidates; calibration poses B, legs L, targets K; m, s.

    ``covariates`` are the columns that are known at every pose, (B,) or (B, L): ``time_s``, ``temperature_c``, others,
    ``order`` (the pose's rank in time over the whole campaign) and ``approach``. ``span_s`` is the first and last time
    of the whole campaign; ``seen`` (B, K) which targets were seen, all where it is not told. ``lengths_apart`` says
    whether a leg's length is another thing than what its actuator moves. Bodies without a mechanism have no legs:
    ``drives`` are columns that these may deform with, ``still`` those that should stand still, ``placed`` those whose
    places x, y, z are known as columns, seen from another one.
    """

    targets: Targets
    shape: NDArray  # (K, 3) in the bodies' frames
    readings: NDArray  # (B, L)
    rho0: NDArray  # (L,)
    poses: tuple[int | str, ...]  # (B,)
    covariates: Mapping[str, NDArray] = field(default_factory=dict)
    span_s: tuple[float, float] | None = None
    reference_temperature_c: float = 20.0
    pitch_m: float | None = None
    flexure_length_m: float | None = None
    lengths_apart: bool = True
    drives: tuple[str, ...] = ()
    still: tuple[str, ...] = ()
    placed: tuple[str, ...] = ()
    weight: Weight | None = None  # None where nothing tells which way is up
    photographed: Photographed | None = None  # None where points were not computed from photographs

    @property
    def inputs(self) -> Mapping[str, NDArray]:
        """The readings (B,) of each actuator."""
        return {f"rho{leg}_mm": values for leg, values in enumerate(self.readings.T, 1)}

    @property
    def legs(self) -> int:
        """Return the number of legs L."""
        return len(self.rho0)

    def varies(self, column: str) -> bool:
        """Return whether a covariate is there and takes more than one value."""
        found = self.covariates.get(column)
        return found is not None and bool(np.ptp(found) > 0)


class PointCause(Cause[PointScene]):
    """A cause that changes fields of a `State`.

    ``reads`` names the fields of the state that its effect depends on, beside covariates: what moves them moves the
    effect. One that names less than it reads has a wrong derivative; ``pose`` stands for p and R, which are found only
    after the structure's effects, so that a cause that reads it costs a few rounds. A ``moved`` target may depend on
    its own ``shape``, and on no other target's; nothing else may depend on shapes.
    """

    reads: ClassVar[frozenset[str]] = LEG_FIELDS | {"shape"}

    def change(self, state: State, values: NDArray) -> Change:
        """Return the derivative of the state's fields by the parameters at values (P,), in SI; complex-safe.

        Causes that are linear in their parameters need no values.
        """
        raise NotImplementedError

    def shift(self, state: State, values: NDArray) -> dict[str, NDArray]:
        """Return by how much the state's fields change at values (P,); for a linear cause, change times values."""
        return {name: slope @ values for name, slope in self.change(state, values).fields.items()}

    def recorded(self, points: NDArray, state: State, values: NDArray) -> NDArray:
        """Return how an instrument passes on points, or their motions, (B, K, 3, ...): linear, without offset."""
        return points


def applied(effect: Effect[PointCause], state: State) -> State:
    """The state as an effect leaves it."""
    return state.shifted(effect.cause.shift(state, effect.values))
