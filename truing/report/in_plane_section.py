"""Shifts of the attachments in the platform's plane, next to those along z: sentence, test, maps and table."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from truing.report.coefficient_map import coefficient_map
from truing.report.column_heads import Head
from truing.report.model_tests import REJECTED, ModelTest, by_p
from truing.report.numbers import p_equals, quantity
from truing.report.page import Drawn, Listing
from truing.report.tables import Tables, table_or_none

_UNLIKELY = 0.01  # p-value below which attachments shift in the plane
_MODEL = "in-plane"  # the model of shifts along x and y
_SIGMAS = {"z": "sigma_um", "x": "sigma_bx_um", "y": "sigma_by_um"}

Facts = Mapping[tuple[str, str], float]


def in_plane_sentence(facts: Facts) -> list[str]:
    """Return the shift in the plane that follows the actuators, next to that along z, and the detectable size."""
    p = facts.get((_MODEL, "p_value_over_none"))
    if p is None:
        return []
    size = {name: quantity(facts[key], "um") for name, key in _SIZES.items() if key in facts}
    words = []
    if p < _UNLIKELY:
        shift, left = (quantity(facts[(_MODEL, name)], "um") for name in ("rms_shift", "rms_left"))
        words.append(
            f"Attachments also shift in the platform's plane with the actuators (p {p_equals(p)}): {shift} rms "
            f"along x and y, {left} after a matrix model."
        )
    if len(size) < len(_SIZES):
        return words
    if p < _UNLIKELY:
        words.append(f"The part that follows the actuators is {size['plane']} rms per axis, and {size['z']} along z.")
    else:
        words.append(
            f"The part that follows the actuators is {size['z']} rms along z, and at most {size['upper']} per axis in "
            f"the plane (95 %). A shift of {size['detectable']} in the plane would be found with a probability of 95 %."
        )
    return words


_SIZES = {
    "z": ("matrix", "rms_following"),
    "plane": (_MODEL, "rms_following"),
    "upper": (_MODEL, "rms_following_upper"),
    "detectable": (_MODEL, "rms_detectable"),
}


def in_plane_test(facts: Facts) -> list[ModelTest]:
    """Return the test if attachments shift along z alone, where it was made."""
    p = facts.get((_MODEL, "p_value_over_none"))
    if p is None or p != p:
        return []
    detectable = quantity(facts.get((_MODEL, "rms_detectable")), "um")
    power = f" A shift of {detectable} rms would be found with a probability of 95 %." if detectable != "–" else ""
    meanings = (f"No shift in the plane exceeds chance.{power}", "Attachments shift in the plane with the actuators.")
    asked = "attachments shift only along z, not in the platform's plane"
    return [by_p(asked, p, _UNLIKELY, meanings, "", REJECTED)]


def in_plane_maps(tables: Tables) -> Drawn:
    """Return the maps of K along x and y, where an entry differs from zero."""
    models = table_or_none(tables, "deformation_models")
    if models is None or "axis" not in models:
        return []
    rows = models[models["model"] == _MODEL]
    if "significant" not in rows or not rows["significant"].any():
        return []
    words = "Row: attachment that shifts in the plane. Column: actuator that moves it."
    return [(coefficient_map(rows[rows["axis"] == axis], axis), words) for axis in "xy"]


def directions(tables: Tables) -> tuple[Listing, ...]:
    """Return the rms shift of every attachment along z, x and y of the platform, with the rms of its sigma."""
    shifts = table_or_none(tables, "deformation")
    if shifts is None or "delta_bx_um" not in shifts:
        return ()
    used = shifts[~shifts["rejected"]] if "rejected" in shifts else shifts
    rows = [(f"leg {leg}", *_cells(group)) for leg, group in used.groupby("leg")]
    heads = (
        Head("attachment", "Attachment of a leg on the platform, by the number of the leg."),
        *(
            one
            for axis in _SIGMAS
            for one in (
                Head(
                    f"rms Δb_{axis}",
                    f"Root mean square over the poses of the attachment's shift along {axis} of the platform.",
                ),
                Head("rms sigma", "Root mean square standard deviation of the shift in the column before."),
            )
        ),
    )
    caption = "Shifts of the attachments along the axes of the platform, over all poses"
    return (Listing(heads, (*rows, ("all", *_cells(used))), (), caption, True, "deformation.parquet"),)


def _cells(table: pd.DataFrame) -> list[str]:
    columns = (name for axis, sigma in _SIGMAS.items() for name in (f"delta_b{axis}_um", sigma))
    return [quantity(float(np.sqrt(np.nanmean(table[name].to_numpy(dtype=float) ** 2))), "um") for name in columns]
