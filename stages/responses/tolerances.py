"""Errors of a force sensor's platform by the tolerances in campaign.toml, as tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.bench.six_upur.assembly import (
    LINKS,
    SOURCES,
    angles_between,
    influence_coefficients,
    joined_links,
    length_of_source,
    sensor_chains,
)
from truing.simulation.bench.six_upur.source_errors import ALL, SourceErrors, source_errors
from truing.simulation.bench.six_upur.tolerances import sigma_of
from truing.stages.common.nominal_mechanism import FILE
from truing.stages.common.rows import Rows
from truing.stages.common.sensor_elements import sensor_joints

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism

_ARCSEC = np.pi / 180.0 / 3600.0
_PARTS = (("position", "um", 1e6), ("attitude", "arcsec", 1.0 / _ARCSEC))
_SEED = 8
_DECIMALS = 9  # of mm, degrees and unit vectors: far below any drawing's


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
        errors = source_errors(sensor_joints(section), sigma_of(widths) * 1e-6, np.random.default_rng(seed))
    except ValueError as error:
        raise CampaignFaults([Fault(FILE, str(error), column="mechanism")]) from None
    return {"tolerance_errors": _errors(errors, widths), "tolerance_samples": _samples(errors)}


def chain_tables(settings: Campaign) -> dict[str, pa.Table]:
    """Return the legs of a sensor as chains (force-sensor paper, eq. 5-13): ``links``, and ``influence``, the error of
    the platform by 1 um of each source of each leg alone, the other legs removed."""
    chain = sensor_chains(sensor_joints(cast("SensorMechanism", settings.mechanism)))
    links = joined_links(chain)
    legs = len(links.axis)
    numbers = {"leg": np.repeat(np.arange(legs) + 1, LINKS), "link": np.tile(np.arange(LINKS) + 1, legs)}
    nothing = np.full((legs, 1), np.nan)
    # Angles about axes and normals, by eq. 12: the chain's own, but from its vectors.
    twist = np.concatenate([angles_between(links.axis, links.normal[:, 1:]), nothing], -1)
    angle = np.concatenate([angles_between(links.normal, links.axis[:, :-1]), nothing], -1)
    of_links: dict[str, object] = {
        "length_mm": chain.a.ravel() * 1e3,
        "offset_mm": chain.S.ravel() * 1e3,
        "angle_deg": _rounded(np.degrees(angle)).ravel(),
        "twist_to_next_deg": _rounded(np.degrees(twist)).ravel(),
    }
    vectors = {"axis": links.axis, "normal": links.normal, "corner": links.corner * 1e3}
    for name, vector in vectors.items():
        ending = "_mm" if name == "corner" else ""
        of_links |= {f"{name}_{c}{ending}": _rounded(vector[..., k]).ravel() for k, c in enumerate("xyz")}
    slopes = length_of_source(influence_coefficients(links))
    parts = ("x_um", "y_um", "z_um", "rx_arcsec", "ry_arcsec", "rz_arcsec")
    scale = np.array([1.0] * 3 + [1e-6 / _ARCSEC] * 3)
    of_sources: dict[str, object] = {
        "leg": np.repeat(np.arange(legs) + 1, len(SOURCES)),
        "error_source": list(SOURCES) * legs,
    }
    of_sources |= {name: _rounded(slopes[:, k] * scale[k]).ravel() for k, name in enumerate(parts)}
    return {"links": pa.table(numbers | of_links), "influence": pa.table(of_sources)}


def _rounded(values: NDArray) -> NDArray:
    return np.round(values, _DECIMALS) + 0.0


def has_tolerances(settings: Campaign) -> bool:
    """True if campaign.toml has a force sensor with the tolerance of a length."""
    if settings.mechanism.type != "6-upur":
        return False
    tolerance = cast("SensorMechanism", settings.mechanism).tolerance
    return any(getattr(tolerance, f"{source}_um") for source in SOURCES)


def _errors(errors: SourceErrors, widths: np.ndarray) -> pa.Table:
    rows = Rows("tolerance_errors")
    for k, source in enumerate(errors.sources):
        for j, (part, unit, scale) in enumerate(_PARTS):
            rows.add(
                error_source=source,
                pose_part=part,
                tolerance_width_um=None if source == ALL else float(widths[SOURCES.index(source)]),
                unit=unit,
                first_order=scale * errors.first_order[k, j],
                sample_rms=scale * errors.band.value[k, j],
                low=scale * errors.band.low[k, j],
                high=scale * errors.band.high[k, j],
                error_95=scale * errors.covered[k, j],
                variance_share=min(1.0, errors.shares[k, j]),
                open_chains=scale * errors.open_chains[k, j],
            )
    return rows.table()


def _samples(errors: SourceErrors) -> pa.Table:
    rows = Rows("tolerance_samples")
    for k, source in enumerate(errors.sources):
        position, attitude = (scale * errors.samples[k, j] for j, (_, _, scale) in enumerate(_PARTS))
        rows.add(
            error_source=source,
            sample=np.arange(len(position)) + 1,
            platform_shift_um=position,
            platform_turn_arcsec=attitude,
        )
    return rows.table()
