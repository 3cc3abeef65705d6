"""The catalogue of causes: what can make nature depart from the plain simulation, by id."""

from __future__ import annotations

from importlib.metadata import entry_points

from truing.simulation.causes.platform_deformation import LinearPlatformDeformation, MatrixPlatformDeformation
from truing.simulation.chain import Cause

OWN_CAUSES = (LinearPlatformDeformation(), MatrixPlatformDeformation())
# A lab's package names its own causes under this group: `"my-cause" = "my_package.causes:MyCause"`.
ENTRY_POINTS = "truing.causes"


def catalogue() -> dict[str, Cause]:
    """Return all causes by id: the project's own, then those of installed packages.

    Raises ValueError where two causes have the same id.
    """
    found: dict[str, Cause] = {}
    for cause in (*OWN_CAUSES, *(point.load()() for point in sorted(entry_points(group=ENTRY_POINTS)))):
        if cause.id in found:
            raise ValueError(f"cause {cause.id}: found in two places, expected one")
        found[cause.id] = cause
    return found
