"""Encoder readings in a second campaign, predicted by the commands and by the extended model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from truing.simulation.axis.extended_model import predict_axis, read_axis
from truing.stages.common.axis_columns import columns_of, command_sigma, encoder_sigma
from truing.stages.second_campaign.compared import EXTENDED, NOMINAL, PredictionErrors, SecondCampaign


def predicted_encoders(text: str, second: SecondCampaign) -> Iterator[PredictionErrors]:
    """Yield errors of every encoder (arcsec or um), counted from its own mean, by command and by extended model.

    Raises CampaignFaults where the second campaign is of another axis, ValueError where it lacks what effects follow.
    """
    extended, section = read_axis(text), second.settings.mechanism
    if section.type != "axis":
        raise second.refuse("mechanism.type", "axis", section.type)
    table = second.tables["configurations"]
    columns = columns_of(second.settings, table)
    for key, here, other in (("kind", extended.axis.kind, columns.kind), ("loop", extended.axis.loop, columns.loop)):
        if here != other:
            raise second.refuse(f"mechanism.{key}", here, other)
    off = command_sigma(second.settings)
    rows, deviations = columns.rows(table, off), columns.deviations(table)
    needed = {name for effect in extended.effects if effect.cause.is_persistent for name in effect.cause.needs(0)}
    if missing := sorted(needed - set(table.schema.names)):
        raise ValueError(f"the extended model follows {', '.join(missing)}, which the second campaign does not hold")
    unit, si = columns.reported_unit
    names = [effect.cause.id for effect in extended.effects if effect.cause.is_persistent]
    words = f"with {', '.join(dict.fromkeys(names))}" if names else "no effect that lasts"
    value, _ = predict_axis(extended, rows)
    for by, sentence, off_command in ((NOMINAL, "as commanded", np.zeros(value.shape)), (EXTENDED, words, value)):
        for k, encoder in enumerate(columns.encoders):
            if encoder not in extended.axis.encoders:
                continue
            index = extended.axis.encoders.index(encoder)
            predicted = off_command[:, index] - (rows.command if by == EXTENDED else 0.0)
            missed = deviations[:, k] - predicted
            sigma = encoder_sigma(second.settings, encoder)
            noise = None if sigma is None else float(np.hypot(sigma, off) / si)
            yield PredictionErrors(by, sentence, encoder, unit, (missed - np.nanmean(missed)) / si, noise)
