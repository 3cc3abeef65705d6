"""The catalogue of causes: what can make nature depart from the plain simulation, by id."""

from __future__ import annotations

from truing.simulation.causes.platform_deformation import LinearPlatformDeformation, MatrixPlatformDeformation
from truing.simulation.chain import Cause

CATALOGUE: dict[str, Cause] = {cause.id: cause for cause in (LinearPlatformDeformation(), MatrixPlatformDeformation())}
