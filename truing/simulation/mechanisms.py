"""Mechanisms by type: data plus a closure."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from truing.simulation.legs import Legs
from truing.simulation.six_pus import SixPus
from truing.simulation.ups import Ups

CLOSURES = {closure.name: closure for closure in (SixPus(), Ups())}


def mechanism(
    kind: str,
    a: ArrayLike,
    b: ArrayLike,
    u: ArrayLike | None,
    l: ArrayLike,  # noqa: E741
    rho0: ArrayLike,
) -> Legs:
    """Return the legs of a mechanism of type ``6-pus`` or ``ups`` from its data in m.

    Shapes as in `Legs`. Without u (a ups needs none) the actuators point along z of the base.
    Raises ValueError for an unknown type or arrays that do not match.
    """
    if kind not in CLOSURES:
        raise ValueError(f"mechanism type: found {kind!r}, expected one of {', '.join(CLOSURES)}")
    joints = np.asarray(a, float)
    directions = np.broadcast_to([0.0, 0.0, 1.0], joints.shape) if u is None else np.asarray(u, float)
    arrays = (joints, np.asarray(b, float), directions, np.asarray(l, float), np.asarray(rho0, float))
    wanted = (joints.shape, joints.shape, joints.shape, joints.shape[:-1], joints.shape[:-1])
    if joints.shape[-1:] != (3,) or any(array.shape != shape for array, shape in zip(arrays, wanted, strict=True)):
        raise ValueError(f"legs: found shapes {[array.shape for array in arrays]}, expected {list(wanted)}")
    return Legs(*arrays, CLOSURES[kind])
