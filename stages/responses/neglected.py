"""Effects that the simulated compliance leaves out: plates and own weight, entry by entry against its uncertainty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.simulation.bench.six_upur.nominal_sensor import SimulatedCompliance
from truing.simulation.bench.six_upur.plates import OwnWeight, at_base, at_platform, own_weight, with_plate
from truing.stages.common.rows import Rows
from truing.stages.common.sensor_elements import elastic_parts, leg_elements, leg_mass_kg, plate_mass_kg, plate_of

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism
    from truing.simulation.bench.six_upur.stiffness import ElasticSensor

NEGLIGIBLE = 1.0 / 3.0  # of a standard deviation: it would raise the uncertainty by 6 %
_MM = 1e-3
_ROUNDED = 1e-9  # um and arcsec: rounding of a symmetric sensor
_HALF = 0.5  # of a leg's mass rests on the platform


def neglected_effects(
    settings: Campaign, simulated: SimulatedCompliance | None, compliance: pa.Table
) -> dict[str, pa.Table]:
    """Tables `neglected` and `own_weight` of a sensor with elements whose plates or masses are declared; else none."""
    if settings.mechanism.type != "6-upur" or simulated is None:
        return {}
    section: SensorMechanism = settings.mechanism  # type: ignore[assignment]
    elastic = elastic_parts(section)
    if elastic is None:
        return {}
    effects = dict(_plates(section, elastic))
    weight = _weight(section, elastic, settings)
    if weight is not None:
        effects["own weight"] = weight.compliance
    if not effects:
        return {}
    uncertainty = np.hypot(simulated.sigma, _measured_sigma(compliance))
    tables = {"neglected": _rows(effects, elastic.compliance, uncertainty).table()}
    return tables if weight is None else tables | {"own_weight": _weight_rows(section, weight, settings).table()}


def _plates(section: SensorMechanism, elastic: ElasticSensor) -> Iterator[tuple[str, Array]]:
    """Yield the plates that the simulation leaves out, with the compliance (6, 6) that contains them."""
    for name, declared, added in (("platform", section.platform, at_platform), ("base", section.base, at_base)):
        if declared is not None and not declared.elastic:
            yield f"elastic {name}", with_plate(elastic, added(plate_of(declared), elastic.joints))


def _weight(section: SensorMechanism, elastic: ElasticSensor, settings: Campaign) -> OwnWeight | None:
    mass = _carried_kg(section)
    if not mass:
        return None
    up = np.array(settings.measurement.up or (0.0, 0.0, 1.0))
    centre = np.array(section.platform.com_mm if section.platform is not None else (0.0, 0.0, 0.0)) * _MM
    return own_weight(elastic, leg_elements(section), mass, centre, up / np.linalg.norm(up))


def _carried_kg(section: SensorMechanism) -> float:
    """Mass on the legs: the platform's, and half of their own."""
    platform = 0.0 if section.platform is None else plate_mass_kg(section.platform, _radius(section))
    return platform + _HALF * len(section.legs) * leg_mass_kg(section)


def _radius(section: SensorMechanism) -> float:
    """Largest radius of the upper joints, mm."""
    return max(float(np.hypot(*leg.b_mm[:2])) for leg in section.legs)


def _measured_sigma(compliance: pa.Table) -> Array:
    """Standard deviation (6, 6) of measured entries; 0 for those that were not measured."""
    sigma = np.zeros((6, 6))
    for row in compliance.to_pylist():
        if row["model"] == "matrix":
            sigma[CHANNELS.index(row["response"]), LOADS.index(row["load"])] = row["sigma"]
    return sigma


def _rows(neglected: Mapping[str, Array], plain: Array, uncertainty: Array) -> Rows:
    rows = Rows("neglected")
    i, j = (index.ravel() for index in np.indices((6, 6)))
    for effect, changed in neglected.items():
        change = (changed - plain).ravel()
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(uncertainty.ravel() > 0.0, np.abs(change) / uncertainty.ravel(), np.nan)
        rows.add(
            effect=effect,
            response=[CHANNELS[k] for k in i],
            load=[LOADS[k] for k in j],
            coefficient=plain.ravel(),
            effect_change=change,
            sigma=uncertainty.ravel(),
            unit=[f"{'m' if a < 3 else 'rad'}/{'N' if b < 3 else '(N m)'}" for a, b in zip(i, j, strict=True)],
            effect_over_sigma=ratio,
            verdict=[_verdict(value) for value in ratio],
        )
    return rows


def _verdict(ratio: float) -> str | None:
    if not np.isfinite(ratio):
        return None
    return "negligible" if ratio <= NEGLIGIBLE else "not negligible"


def _weight_rows(section: SensorMechanism, weight: OwnWeight, settings: Campaign) -> Rows:
    rows = Rows("own_weight")
    size = float(np.linalg.norm(weight.wrench[:3]))
    platform = 0.0 if section.platform is None else plate_mass_kg(section.platform, _radius(section))
    rows.add(figure="mass", subject="platform", value=platform, unit="kg")
    rows.add(figure="mass", subject="legs", value=len(section.legs) * leg_mass_kg(section), unit="kg")
    rows.add(figure="weight", subject="platform and half of the legs", value=size, unit="N")
    if settings.loading.fz_n is not None:
        rows.add(figure="weight over range", subject="fz", value=size / settings.loading.fz_n, unit="1")
    for k, channel in enumerate(CHANNELS):
        factor, unit = (1e6, "um") if k < 3 else (180.0 * 3600.0 / np.pi, "arcsec")
        value = factor * weight.displacement[k]
        rows.add(figure="displacement", subject=channel, value=value if abs(value) > _ROUNDED else 0.0, unit=unit)
    for k, tension in enumerate(weight.tension):
        rows.add(figure="leg tension", subject=f"leg {k + 1}", value=float(tension), unit="N")
    return rows
