"""From the rows of an axis to what the diagnosis compares: readings of its encoders minus its commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.inference.observations import Epochs, Frames, Observations
from truing.simulation.axis.model import AxisModel
from truing.simulation.axis.rows import AxisRows
from truing.stages.common.axis_columns import AxisColumns, columns_of, command_sigma, encoder_sigma
from truing.stages.common.axis_prospects import is_held_out, why_no_diagnosis
from truing.stages.diagnosis.axis_artifacts import axis_artifacts
from truing.stages.diagnosis.mechanism_points import Gathered
from truing.stages.diagnosis.shown import Channels

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign
    from truing.schemas.sections import Overrule

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# The zero of an encoder is anywhere: so many times as far as its readings lie from the commands.
_WIDE = 1e3
_SCATTER = "Send the axis to one command ten times over from the same side: the scatter is the true noise."


def gather(tables: Mapping[str, pa.Table], settings: Campaign) -> Gathered:
    """Return what the diagnosis compares; raises ValueError, saying why, where the campaign does not hold it."""
    if why := why_no_diagnosis(tables, settings):
        raise ValueError(why)
    table = tables["configurations"]
    columns = columns_of(settings, table)
    off = command_sigma(settings)
    rows, deviations = columns.rows(table, off), columns.deviations(table)
    out, kept = (_chosen(rules, rows) for rules in (settings.exclude, settings.keep))
    seen = np.isfinite(deviations) & ~out[:, None]
    held = is_held_out(table)
    fitted = seen.any(1) & ~held
    held &= seen.any(1)
    largest = float(np.abs(np.where(seen, deviations, 0.0)).max())
    sigma = np.array([encoder_sigma(settings, name) for name in columns.encoders], float)
    middle = np.nanmedian(np.where(seen, deviations, np.nan), axis=0)
    spread = float(np.abs(np.where(seen, deviations - middle, 0.0)).max())
    noise = float(np.hypot(off, np.median(sigma)))
    model = AxisModel(
        replace(columns.axis(off), spread=spread, noise=noise),
        rows.chosen(fitted),
        _WIDE * max(largest, float(sigma.max())),
        off,
    )

    def poses(own: Mask) -> Epochs:
        covariance = np.broadcast_to(sigma**2, seen[own].shape)[..., None, None]
        measured = Observations(np.where(seen, deviations, 0.0)[own][..., None], covariance, seen[own])
        keep = np.broadcast_to(kept[own][:, None], seen[own].shape)
        return Epochs(measured, rows.chosen(own), Frames.of_numbers(int(own.sum())), keep)

    return Gathered(
        model,
        poses(fitted),
        poses(held) if held.any() else None,
        f"{int(out.sum())} rows excluded by a person" if out.any() else "",
        None,
        shown=_shown(columns),
        leaves=axis_artifacts,
    )


def _shown(columns: AxisColumns) -> Channels:
    unit, si = columns.told
    count = len(columns.encoders)
    return Channels(
        (unit,) * count,
        np.full(count, si),
        np.zeros(count, bool),
        epoch="row",
        fitted="the rows fitted",
        held_out="held-out rows",
        drive="the command",
        scatter=_SCATTER,
    )


def _chosen(rules: tuple[Overrule, ...], rows: AxisRows) -> Mask:
    """Which rows (N,) a person named; a rule on a body, a target or nothing concerns no row."""
    named = {str(rule.pose) for rule in rules if rule.pose is not None and rule.body is None and rule.target is None}
    return np.array([str(pose) in named for pose in rows.poses], bool)
