"""Errors in a second campaign of the models of the first one, for every kind of campaign."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import pyarrow as pa

from truing.schemas.settings_text import parsed_toml
from truing.simulation.axis.extended_model import is_axis
from truing.simulation.bench.extended_model import is_sensor
from truing.simulation.mechanisms.chains.extended_model import is_chain
from truing.stages.common.belonging import reason_withheld
from truing.stages.common.rows import Rows
from truing.stages.second_campaign.compared import ARTIFACT, PredictionErrors, SecondCampaign, add_all_errors

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign


def second_campaign_errors(
    text: str, second: SecondCampaign, tables: Mapping[str, pa.Table], settings: Campaign | None = None
) -> tuple[pa.Table, str]:
    """Return rows of second_campaign_errors.parquet, and models of the first campaign without prediction, with the
    reasons.

    text: the extended model of the first campaign; tables, settings: what else there is of that campaign, its
    ``calibration`` and ``model_choice``, and its signals. Raises CampaignFaults where the second campaign is of another
    machine, ValueError, saying why, where nothing of it can be predicted.
    """
    if why := reason_withheld(second.tables):
        raise ValueError(f"second campaign: {why}")
    rows, left_out = Rows(ARTIFACT), ""
    add_all_errors(rows, second, _predicted(text, second, tables))
    if settings is not None and settings.campaign.kind == "interferometer":
        from truing.stages.second_campaign.loads import predicted_by_matrix

        try:
            add_all_errors(rows, second, predicted_by_matrix(tables, settings, second))
        except ValueError as why:
            left_out = f"loads by signals: {why}"
    if not rows.count:
        raise ValueError(left_out or "the second campaign holds nothing that the models predict")
    return rows.table(), left_out


def _predicted(text: str, second: SecondCampaign, tables: Mapping[str, pa.Table]) -> Iterator[PredictionErrors]:
    document = parsed_toml(text)
    if is_axis(document):
        from truing.stages.second_campaign.axes import predicted_encoders

        yield from predicted_encoders(text, second)
    elif is_chain(document):
        from truing.stages.second_campaign.chains import predicted_links

        yield from predicted_links(text, second)
    elif is_sensor(document):
        from truing.stages.second_campaign.loads import predicted_readings

        if second.settings.campaign.kind != "interferometer":
            raise second.refuse("campaign.kind", "interferometer", second.settings.campaign.kind)
        yield from predicted_readings(text, second)
    else:
        from truing.stages.second_campaign.poses import predicted_poses

        yield from predicted_poses(text, tables, second)
