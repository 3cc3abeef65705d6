"""Errors of a force sensor's platform by the tolerances in campaign.toml, as tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.bench.six_upur.assembly import SOURCES
from truing.simulation.bench.six_upur.source_errors import ALL, SourceErrors, source_errors
from truing.simulation.bench.six_upur.tolerances import sigma_of
from truing.stages.common.nominal_mechanism import FILE
from truing.stages.common.rows import Rows
from truing.stages.common.sensor_elements import sensor_joints

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism

LEAVES = ("tolerance_errors", "tolerance_samples")
_ARCSEC = np.pi / 180.0 / 3600.0
_PARTS = (("position", "um", 1e6), ("attitude", "arcsec", 1.0 / _ARCSEC))
_SEED = 8


def tolerance_tables(settings: Campaign, seed: int = _SEED) -> dict[str, pa.Table]:
    """Return the tables of the errors by each source and of drawn sensors; raises CampaignFaults without tolerances."""
    if settings.mechanism.type != "6-upur":
        expected = "6-upur, a force sensor with tolerances of its legs"
        raise CampaignFaults([Fault(FILE, expected, column="mechanism.type", value=settings.mechanism.type)])
    section = cast("SensorMechanism", settings.mechanism)
    widths = np.array([getattr(section.tolerance, f"{source}_um") or 0.0 for source in SOURCES])
    if not widths.any():
        expected = f"at least one of {', '.join(f'{source}_um' for source in SOURCES)} above 0"
        raise CampaignFaults([Fault(FILE, expected, column="mechanism.tolerance")])
    try:
        found = source_errors(sensor_joints(section), sigma_of(widths) * 1e-6, np.random.default_rng(seed))
    except ValueError as error:
        raise CampaignFaults([Fault(FILE, str(error), column="mechanism")]) from None
    return {"tolerance_errors": _errors(found, widths), "tolerance_samples": _samples(found)}


def has_tolerances(settings: Campaign) -> bool:
    """True if campaign.toml has a force sensor with the tolerance of a length."""
    if settings.mechanism.type != "6-upur":
        return False
    tolerance = cast("SensorMechanism", settings.mechanism).tolerance
    return any(getattr(tolerance, f"{source}_um") for source in SOURCES)


def _errors(found: SourceErrors, widths: np.ndarray) -> pa.Table:
    rows = Rows("tolerance_errors")
    for k, source in enumerate(found.sources):
        for j, (part, unit, scale) in enumerate(_PARTS):
            rows.add(
                error_source=source,
                pose_part=part,
                tolerance_width_um=None if source == ALL else float(widths[SOURCES.index(source)]),
                unit=unit,
                first_order=scale * found.first_order[k, j],
                sample_rms=scale * found.band.value[k, j],
                low=scale * found.band.low[k, j],
                high=scale * found.band.high[k, j],
                error_95=scale * found.covered[k, j],
                variance_share=min(1.0, found.shares[k, j]),
                open_chains=scale * found.open_chains[k, j],
            )
    return rows.table()


def _samples(found: SourceErrors) -> pa.Table:
    rows = Rows("tolerance_samples")
    for k, source in enumerate(found.sources):
        position, attitude = (scale * found.samples[k, j] for j, (_, _, scale) in enumerate(_PARTS))
        rows.add(
            error_source=source,
            sample=np.arange(len(position)) + 1,
            platform_shift_um=position,
            platform_turn_arcsec=attitude,
        )
    return rows.table()
