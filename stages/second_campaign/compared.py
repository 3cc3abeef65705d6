"""Tables of a second campaign, test of the same machine, and rows of errors for all instruments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from truing.arrays import Array, Mask
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

NOMINAL, CALIBRATED, EXTENDED = "nominal", "calibrated", "extended"
ARTIFACT = "second_campaign_errors"
_FEWEST_PAIRS = 5


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
    """Measured minus predicted by one model: errors (N,) of a quantity, in its unit; the rms of noise alone.

    ``beyond`` (N,): values at readings outside the range of the fitted poses; None if the model states no range.
    """

    prediction_by: str
    model: str
    quantity: str
    unit: str
    errors: Array
    noise_rms: float | None = None
    beyond: Mask | None = None


def add_all_errors(rows: Rows, second: SecondCampaign, found: Iterable[PredictionErrors]) -> None:
    """Add a row per model and quantity, compared with the nominal model's; none where nothing could be predicted."""
    nominal: dict[str, Array] = {}
    for of_model in found:
        if of_model.prediction_by == NOMINAL:
            nominal[of_model.quantity] = of_model.errors
        _add_errors(rows, second, of_model, nominal.get(of_model.quantity))


def _add_errors(rows: Rows, second: SecondCampaign, found: PredictionErrors, nominal: Array | None) -> None:
    is_known = np.isfinite(found.errors)
    errors = found.errors[is_known]
    if not len(errors):
        return
    is_compared = nominal is not None and found.prediction_by != NOMINAL and len(nominal) == len(found.errors)
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
        p_worse=probability_worse(found.errors, nominal) if is_compared and nominal is not None else None,
        beyond_range=None if found.beyond is None else int(found.beyond[is_known].sum()),
    )


def probability_worse(errors: Array, nominal: Array) -> float | None:
    """Return the one-sided p-value that errors (N,) are as large as nominal ones (N,), of the same values in pairs.

    The mean difference of squares over its standard error is normal. None for fewer than 5 pairs.
    """
    gap = errors**2 - nominal**2
    gap = gap[np.isfinite(gap)]
    if len(gap) < _FEWEST_PAIRS:
        return None
    error = float(gap.std(ddof=1)) / np.sqrt(len(gap))
    return float(ndtr(-gap.mean() / error)) if error > 0.0 else 0.5
