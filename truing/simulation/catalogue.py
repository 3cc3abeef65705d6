"""Catalogues of all causes by id, one for each sort of model; causes of installed packages are included."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from truing.schemas.installed import with_installed
from truing.simulation.axis.causes import AxisCause, AxisGrowth, LostMotion, ScaleError, ZeroShift
from truing.simulation.axis.nonparametric import NonparametricAxisEffect
from truing.simulation.axis.periodic import AxisPeriodicError
from truing.simulation.axis.reading_lag import AxisReadingLag
from truing.simulation.axis.scatter import AxisScatter
from truing.simulation.axis.slip import EncodersDisagree
from truing.simulation.bench.causes.beams import AbbeOffset, CosineError
from truing.simulation.bench.causes.channels import DeadPath, ThermalDrift, ZeroDrift
from truing.simulation.bench.causes.counts import Crosstalk, FringeSlip
from truing.simulation.bench.causes.leg_stiffness import LegStiffness
from truing.simulation.bench.causes.load_history import Creep
from truing.simulation.bench.causes.load_path import LoadEccentricity, LoadImbalance
from truing.simulation.bench.causes.noise_burst import NoisyRun
from truing.simulation.bench.causes.nonparametric import NonparametricReadingEffect
from truing.simulation.bench.causes.play_hysteresis import PlayHysteresis
from truing.simulation.bench.causes.reading_causes import ReadingCause
from truing.simulation.bench.causes.rows_exchanged import RowsExchanged
from truing.simulation.bench.causes.signal_hysteresis import SignalHysteresis
from truing.simulation.bench.causes.signal_nonlinear import SignalNonlinear
from truing.simulation.bench.causes.stiffness import (
    Hysteresis,
    JointClearance,
    StiffnessAsymmetry,
    StiffnessNonlinear,
    StiffnessScale,
)
from truing.simulation.bench.causes.zero_step import ZeroStep
from truing.simulation.bodies.causes.deformation import BodyDeformation
from truing.simulation.bodies.causes.drift import BodyDrift
from truing.simulation.bodies.causes.gravity import GravitySag
from truing.simulation.bodies.causes.jump import BodyJump
from truing.simulation.cause import Cause, CauseT
from truing.simulation.mechanisms.causes.deformation import (
    BaseDeformation,
    FlexureShift,
    InPlanePlatformDeformation,
    LinearPlatformDeformation,
    MatrixPlatformDeformation,
    NonlinearPlatformDeformation,
)
from truing.simulation.mechanisms.causes.drive import ActuatorBacklash, ActuatorGain, PeriodicError
from truing.simulation.mechanisms.causes.leg_compliance import LegCompliance
from truing.simulation.mechanisms.causes.leg_drift import LegDrift
from truing.simulation.mechanisms.causes.measurement_scale import MeasurementScale
from truing.simulation.mechanisms.causes.nonparametric import NonparametricMechanismEffect
from truing.simulation.mechanisms.causes.reading_lag import ReadingLag
from truing.simulation.mechanisms.causes.scatter import ApproachScatter, NoiseBurst
from truing.simulation.mechanisms.causes.targets import TargetMoved, TargetsSwapped
from truing.simulation.mechanisms.causes.warmth import LegThermal, ThermalExpansion
from truing.simulation.mechanisms.causes.zero_shift import ActuatorZeroShift
from truing.simulation.mechanisms.chains.base_drift import BaseDrift
from truing.simulation.mechanisms.chains.causes import (
    ChainCause,
    JointBacklash,
    JointCompliance,
    JointGain,
    JointOffset,
    JointScatter,
    JointsExchanged,
)
from truing.simulation.mechanisms.chains.guideways import GuidewayError
from truing.simulation.mechanisms.chains.harmonics import JointEccentricity, JointHarmonic, JointPitchError
from truing.simulation.mechanisms.chains.joint_curves import JointErrorCurve
from truing.simulation.mechanisms.chains.jumps import BaseJump, JointJump, ToolJump
from truing.simulation.mechanisms.chains.link_causes import LinkBending, LinkGrowth
from truing.simulation.mechanisms.chains.loads import ColumnTilt, GravityDirection, JointSag
from truing.simulation.mechanisms.chains.nonparametric import NonparametricChainEffect
from truing.simulation.mechanisms.chains.reading_lag import ChainReadingLag
from truing.simulation.mechanisms.chains.settling import JointSettling
from truing.simulation.mechanisms.chains.target_causes import ChainTargetMoved, DistanceOffset
from truing.simulation.mechanisms.chains.weight_factors import WeightFactor
from truing.simulation.mechanisms.point_causes import PointCause
from truing.simulation.photographs.causes.camera_instability import CameraInstability
from truing.simulation.photographs.causes.nonparametric import NonparametricRayEffect
from truing.simulation.photographs.causes.ray_causes import RayCause
from truing.simulation.photographs.causes.refraction import EvenAir, Refraction
from truing.simulation.photographs.causes.scale_bar_temperature import AllBars, OneBar

OWN_CAUSES: tuple[PointCause, ...] = (
    LinearPlatformDeformation(),
    MatrixPlatformDeformation(),
    NonlinearPlatformDeformation(),
    InPlanePlatformDeformation(),
    ThermalExpansion(),
    BaseDeformation(),
    LegDrift(),
    LegThermal(),
    LegCompliance(),
    FlexureShift(),
    ActuatorGain(),
    ActuatorBacklash(),
    PeriodicError(),
    ActuatorZeroShift(),
    ReadingLag(),
    MeasurementScale(),
    TargetMoved(),
    TargetsSwapped(),
    BodyDeformation(),
    BodyDrift(),
    BodyJump(),
    GravitySag(),
    ApproachScatter(),
    NoiseBurst(),
    NonparametricMechanismEffect(),
)
# Causes of a sensor on its bench.
OWN_CAUSES_OF_READINGS: tuple[ReadingCause, ...] = (
    LoadEccentricity(),
    LoadImbalance(),
    StiffnessScale(),
    StiffnessAsymmetry(),
    StiffnessNonlinear(),
    LegStiffness(),
    Hysteresis(),
    PlayHysteresis(),
    JointClearance(),
    Creep(),
    ZeroDrift(),
    ThermalDrift(),
    CosineError(),
    AbbeOffset(),
    DeadPath(),
    FringeSlip(),
    ZeroStep(),
    Crosstalk(),
    SignalNonlinear(),
    SignalHysteresis(),
    RowsExchanged(),
    NoisyRun(),
    NonparametricReadingEffect(),
)
# Causes of a single axis.
OWN_CAUSES_OF_AXES: tuple[AxisCause, ...] = (
    ScaleError(),
    LostMotion(),
    AxisPeriodicError(),
    ZeroShift(),
    AxisGrowth(),
    EncodersDisagree(),
    AxisReadingLag(),
    AxisScatter(),
    NonparametricAxisEffect(),
)
# Causes of an open chain.
OWN_CAUSES_OF_CHAINS: tuple[ChainCause, ...] = (
    JointOffset(),
    JointJump(),
    JointGain(),
    JointBacklash(),
    JointEccentricity(),
    JointHarmonic(),
    JointPitchError(),
    JointSettling(),
    ChainReadingLag(),
    JointErrorCurve(),
    GuidewayError(),
    JointCompliance(),
    JointSag(),
    GravityDirection(),
    WeightFactor(),
    LinkBending(),
    ColumnTilt(),
    LinkGrowth(),
    BaseDrift(),
    BaseJump(),
    ToolJump(),
    DistanceOffset(),
    ChainTargetMoved(),
    JointScatter(),
    JointsExchanged(),
    NonparametricChainEffect(),
)
# Causes that act on rays of photographs, and on points that were computed from photographs.
OWN_CAUSES_OF_RAYS: tuple[RayCause, ...] = (CameraInstability(), OneBar(), Refraction(), NonparametricRayEffect())
OWN_CAUSES_OF_PHOTOGRAPHED_POINTS: tuple[PointCause, ...] = (AllBars(), EvenAir())
# Causes of mechanisms that also apply to a body without a mechanism.
_OF_BODIES = (
    "thermal-expansion",
    "measurement-scale",
    "target-moved",
    "targets-swapped",
    "body-deformation",
    "body-drift",
    "gravity-sag",
    "approach-scatter",
    "noise-burst",
    "unexplained",
)
# A lab's package names its own causes under this group: `"my-cause" = "my_package.causes:MyCause"`.
ENTRY_POINTS = "truing.causes"


def catalogue() -> dict[str, PointCause]:
    """Return all causes of points by id: truing's own, then those of installed packages.

    Raises ValueError if two causes have the same id.
    """
    return _with_installed(OWN_CAUSES, PointCause)


def catalogue_of_bodies() -> dict[str, PointCause]:
    """Return all causes of bodies without a mechanism, by id, with those of installed packages."""
    of_legs = {cause.id for cause in OWN_CAUSES} - set(_OF_BODIES)
    return {name: cause for name, cause in catalogue().items() if name not in of_legs}


def catalogue_of_readings() -> dict[str, ReadingCause]:
    """Return all causes of a sensor on its bench, by id, with those of installed packages.

    Raises ValueError if two causes have the same id.
    """
    return _with_installed(OWN_CAUSES_OF_READINGS, ReadingCause)


def catalogue_of_axes() -> dict[str, AxisCause]:
    """Return all causes of a single axis, by id, with those of installed packages.

    Raises ValueError if two causes have the same id.
    """
    return _with_installed(OWN_CAUSES_OF_AXES, AxisCause)


def catalogue_of_chains() -> dict[str, ChainCause]:
    """Return all causes of an open chain, by id, with those of installed packages.

    Raises ValueError if two causes have the same id.
    """
    return _with_installed(OWN_CAUSES_OF_CHAINS, ChainCause)


def catalogue_of_rays() -> dict[str, RayCause]:
    """Return all causes that act on rays of photographs, by id, with those of installed packages.

    Raises ValueError if two causes have the same id.
    """
    return _with_installed(OWN_CAUSES_OF_RAYS, RayCause)


def catalogue_of_photographed_points() -> dict[str, PointCause]:
    """Return the additional causes, by id, of points that were computed from photographs."""
    return {cause.id: cause for cause in OWN_CAUSES_OF_PHOTOGRAPHED_POINTS}


OF_TYPES: dict[str, Callable[[], Mapping[str, Cause]]] = {"axis": catalogue_of_axes, "chain": catalogue_of_chains}
"""Catalogues by type of mechanism, for types other than legs and sensors on a bench."""


def _with_installed(built_in: tuple[CauseT, ...], sort: type[CauseT]) -> dict[str, CauseT]:
    """Return truing's own and the installed causes of a sort; raises ValueError if an installed cause is of no known
    sort."""

    def joins(cause: Cause) -> bool:
        if not isinstance(cause, PointCause | ReadingCause | RayCause | AxisCause | ChainCause):
            sorts = "PointCause, ReadingCause, RayCause, AxisCause or ChainCause"
            raise ValueError(f"cause {cause.id}: found a class of no sort, expected a {sorts}")
        return isinstance(cause, sort)

    return with_installed(built_in, ENTRY_POINTS, "cause", lambda cause: cause.id, joins)
