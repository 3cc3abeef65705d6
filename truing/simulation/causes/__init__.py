"""The catalogue of causes: what can make nature depart from the plain simulation, by id."""

from __future__ import annotations

from truing.simulation.cause import Cause
from truing.simulation.causes.base_deformation import BaseDeformation
from truing.simulation.causes.bodies import BodyDeformation
from truing.simulation.causes.body_drift import BodyDrift
from truing.simulation.causes.drive import ActuatorBacklash, ActuatorGain, PeriodicError
from truing.simulation.causes.flexure_shift import FlexureShift
from truing.simulation.causes.leg_drift import LegDrift
from truing.simulation.causes.measurement_scale import MeasurementScale
from truing.simulation.causes.platform_deformation import (
    LinearPlatformDeformation,
    MatrixPlatformDeformation,
    NonlinearPlatformDeformation,
)
from truing.simulation.causes.targets import TargetMoved, TargetsSwapped
from truing.simulation.causes.unexplained import Unexplained
from truing.simulation.causes.warmth import LegThermal, ThermalExpansion
from truing.simulation.installed import with_installed

OWN_CAUSES: tuple[Cause, ...] = (
    LinearPlatformDeformation(),
    MatrixPlatformDeformation(),
    NonlinearPlatformDeformation(),
    ThermalExpansion(),
    BaseDeformation(),
    LegDrift(),
    LegThermal(),
    FlexureShift(),
    ActuatorGain(),
    ActuatorBacklash(),
    PeriodicError(),
    MeasurementScale(),
    TargetMoved(),
    TargetsSwapped(),
    BodyDeformation(),
    BodyDrift(),
    Unexplained(),
)
# Of these, what a body without a mechanism knows.
_OF_BODIES = (
    "thermal-expansion",
    "measurement-scale",
    "target-moved",
    "targets-swapped",
    "body-deformation",
    "body-drift",
    "unexplained",
)
# A lab's package names its own causes under this group: `"my-cause" = "my_package.causes:MyCause"`.
ENTRY_POINTS = "truing.causes"


def catalogue() -> dict[str, Cause]:
    """Return all causes by id: the project's own, then those of installed packages.

    Raises ValueError where two causes have the same id.
    """
    return with_installed(OWN_CAUSES, ENTRY_POINTS, "cause", lambda cause: cause.id)


def catalogue_of_bodies() -> dict[str, Cause]:
    """Return all causes that bodies without a mechanism know, by id; those of installed packages are among them."""
    of_legs = {cause.id for cause in OWN_CAUSES} - set(_OF_BODIES)
    return {name: cause for name, cause in catalogue().items() if name not in of_legs}
