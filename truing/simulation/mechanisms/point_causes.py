"""Base class `PointCause` of causes that act on measured points, of mechanisms or bodies, and their scene
`PointScene`."""

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
    """Errors of points that were computed from photographs, and the scale bars.

    ``errors`` is the number of errors common to all poses (of cameras, of scale bars), each of unit variance.
    ``pose_errors`` is the number of errors common to the points of a pose (its scale, ...). ``scale_height_m`` is the
    height of the ``scale_bars`` in the model's frame, m.
    """

    errors: int = 0
    pose_errors: int = 0
    scale_bars: tuple[str, ...] = ()
    scale_height_m: float = 0.0


@dataclass(frozen=True)
class PointScene(Scene["PointCause"]):
    """Scene of causes that act on points; calibration poses B, legs L, targets K; m, s.

    ``covariates`` are columns known at every pose, (B,) or (B, L): ``time_s``, ``temperature_c``, others, ``order``
    (rank of the pose in time over the whole campaign) and ``approach``. ``span_s`` is the first and last time of the
    whole campaign; ``is_observed`` (B, K) the mask of seen targets, None for all. ``lengths_apart``: the length of a
    leg and the displacement of its actuator act differently.

    Bodies without a mechanism have no legs. ``drives`` are columns that may deform them, and ``still`` the bodies that
    should stand still. ``placed`` are bodies whose positions x, y, z relative to another body are known as columns.
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
    weight: Weight | None = None  # None if the up direction is unknown
    photographed: Photographed | None = None  # None if points do not come from photographs

    @property
    def inputs(self) -> Mapping[str, NDArray]:
        """Readings (B,) of each actuator."""
        return {f"rho{leg}_mm": values for leg, values in enumerate(self.readings.T, 1)}

    @property
    def legs(self) -> int:
        """Number of legs L."""
        return len(self.rho0)

    def varies(self, column: str) -> bool:
        """True if a covariate exists and takes more than one value."""
        covariate = self.covariates.get(column)
        return covariate is not None and bool(np.ptp(covariate) > 0)


class PointCause(Cause[PointScene]):
    """Base class of causes that change fields of a `State`.

    ``reads`` names the fields of the state, except covariates, that the effect depends on; the derivative is wrong if
    one is missing. ``pose`` means p and R; they are found after the effects of the structure, so that reading them
    needs a few more iterations. ``moved`` of a target may depend on its own ``shape`` only; nothing else may depend on
    shapes.
    """

    reads: ClassVar[frozenset[str]] = LEG_FIELDS | {"shape"}

    def change(self, state: State, values: NDArray) -> Change:
        """Return the derivative of the state's fields by the parameters at values (P,), SI; must allow complex numbers.

        Causes that are linear in their parameters ignore the values.
        """
        raise NotImplementedError

    def shift(self, state: State, values: NDArray) -> dict[str, NDArray]:
        """Return the change of the state's fields at values (P,); for a linear cause the derivative times the
        values."""
        return {name: slope @ values for name, slope in self.change(state, values).fields.items()}

    def recorded(self, points: NDArray, state: State, values: NDArray) -> NDArray:
        """Return points, or their motions, (B, K, 3, ...) as recorded by the instrument; must be linear, without
        offset."""
        return points


def applied(effect: Effect[PointCause], state: State) -> State:
    """Return the state after an effect."""
    return state.shifted(effect.cause.shift(state, effect.values))
