"""Tables of a second campaign, test of the same machine, and rows of errors for all instruments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

Array = NDArray[np.float64]
NOMINAL, CALIBRATED, EXTENDED = "nominal", "calibrated", "extended"
ARTIFACT = "second_campaign_errors"


@dataclass(frozen=True)
class SecondCampaign:
    """A second campaign: its campaign.toml, its settings, and the tables that its stages leave up to its poses."""

    file: str
    settings: Campaign
    tables: Mapping[str, pa.Table]

    def refuse(self, key: str, expected: str, actual: str | None = None) -> CampaignFaults:
        """The fault that a key of its campaign.toml describes another machine than the models."""
        same = f"{expected}: models predict a second campaign of the same machine alone"
        return CampaignFaults([Fault(self.file, same, column=key, value=actual)])


@dataclass(frozen=True)
class PredictionErrors:
    """Measured minus predicted by one model: errors (N,) of a quantity, in its unit; the rms of noise alone."""

    prediction_by: str
    model: str
    quantity: str
    unit: str
    errors: Array
    noise_rms: float | None = None


def add_errors(rows: Rows, second: SecondCampaign, found: PredictionErrors) -> None:
    """Add the row of a quantity; nothing where none of it could be predicted."""
    errors = found.errors[np.isfinite(found.errors)]
    if not len(errors):
        return
    rows.add(
        campaign=second.settings.campaign.name,
        prediction_by=found.prediction_by,
        model=found.model,
        quantity=found.quantity,
        rms_error=float(np.sqrt(np.mean(errors**2))),
        largest_error=float(np.abs(errors).max()),
        noise_rms=found.noise_rms,
        count=len(errors),
        unit=found.unit,
    )
