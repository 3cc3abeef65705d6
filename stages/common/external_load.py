"""Load on the platform of a legged mechanism at each pose: weight of the payload, and forces of the campaign."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.formats.raw_tables import WRENCH
from truing.simulation.mechanisms.weight import Weight, weight_wrench
from truing.stages.common.point_arrays import number_column

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism

PAYLOAD = "payload_kg"


def weight_of(section: LeggedMechanism, settings: Campaign) -> Weight | None:
    """Upward direction and payload; None without an upward direction in campaign.toml."""
    mass, (across, along, above) = section.payload_kg, (1e-3 * length for length in section.payload_com_mm)
    if settings.measurement.up is None:
        return None
    x, y, z = np.asarray(settings.measurement.up) / np.linalg.norm(settings.measurement.up)
    return Weight((float(x), float(y), float(z)), mass, (across, along, above))


def external_loads(settings: Campaign, configurations: pa.Table, R: Array) -> Array | None:
    """Wrenches (B, 6) on the platform at its origin, base axes, N and N m, one per row of configurations; None without
    any. R (B, 3, 3): measured rotations of the platform."""
    names, wrench_columns = configurations.column_names, settings.load.wrench
    section = cast("LeggedMechanism", settings.mechanism)
    wrenches = np.zeros((len(R), 6))
    for k, name in enumerate(WRENCH):
        wrenches[:, k] = number_column(configurations, name) if name in names else wrench_columns[k]
    weight = weight_of(section, settings)
    mass = number_column(configurations, PAYLOAD) if PAYLOAD in names else section.payload_kg
    if weight is not None and mass is not None:
        wrenches += weight_wrench(weight, R, np.broadcast_to(mass, len(R)))
    return wrenches if wrenches.any() else None
