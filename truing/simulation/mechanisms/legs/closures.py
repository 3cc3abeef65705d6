"""Mechanisms by type: data plus a closure."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from truing.simulation.installed import with_installed
from truing.simulation.mechanisms.legs.geometry import Closure, Legs
from truing.simulation.mechanisms.legs.six_pus import SixPus
from truing.simulation.mechanisms.legs.ups import Ups

OWN_CLOSURES = (SixPus(), Ups())
# A lab's package names its own closures under this group: `"my-legs" = "my_package.legs:MyClosure"`.
ENTRY_POINTS = "truing.closures"


def closures() -> dict[str, Closure]:
    """Return all closures by name: the project's own, then those of installed packages.

    Raises ValueError where two closures have the same name.
    """
    return with_installed(OWN_CLOSURES, ENTRY_POINTS, "closure", lambda closure: closure.name)


def mechanism(
    kind: str,
    a: ArrayLike,
    b: ArrayLike,
    u: ArrayLike | None,
    l: ArrayLike,  # noqa: E741
    rho0: ArrayLike,
) -> Legs:
    """Return the legs of a mechanism of type ``6-pus``, ``ups`` or a lab's own from its data in m.

    Shapes as in `Legs`. Without u (a ups needs none) the actuators point along z of the base.
    Raises ValueError for an unknown type or arrays that do not match.
    """
    own = {closure.name: closure for closure in OWN_CLOSURES}
    known = own if kind in own else closures()  # looking through what is installed takes its time
    if kind not in known:
        raise ValueError(f"mechanism type: found {kind!r}, expected one of {', '.join(known)}")
    joints = np.asarray(a, float)
    directions = np.broadcast_to([0.0, 0.0, 1.0], joints.shape) if u is None else np.asarray(u, float)
    arrays = (joints, np.asarray(b, float), directions, np.asarray(l, float), np.asarray(rho0, float))
    wanted = (joints.shape, joints.shape, joints.shape, joints.shape[:-1], joints.shape[:-1])
    if joints.shape[-1:] != (3,) or any(array.shape != shape for array, shape in zip(arrays, wanted, strict=True)):
        raise ValueError(f"legs: found shapes {[array.shape for array in arrays]}, expected {list(wanted)}")
    return Legs(*arrays, known[kind])
