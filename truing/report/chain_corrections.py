"""Corrections to the nominal geometry of a chain, and their gain, for the first screen."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from truing.belonging.relation import RelationState
from truing.report.numbers import listed, printed, quantity, with_uncertainty
from truing.report.page import Verdict
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Tables, table_or_none
from truing.schemas.verdict import ReasonCode

_CLEAR = 5.0  # standard deviations: of a hundred numbers, chance passes it once in 17,000 campaigns
_NAMED = 3
NAMES = {"offset": "zero"}
NAMES |= {f"d{axis}": f"shift along {axis} of the frame" for axis in "xyz"}
NAMES |= {f"turn_{axis}": f"rotation about {axis} of the frame" for axis in "xyz"}
DEGREES = {"rad": (180.0 / math.pi, "deg")}


def estimates_zeros(tables: Tables) -> bool:
    """True if the zero of some joint was identified with the geometry, so that it is no effect to be tested."""
    numbers = table_or_none(tables, "chain_parameters")
    return numbers is not None and bool((numbers["identifiable"] & (numbers["parameter"] == "offset")).any())


def clear_numbers(tables: Tables) -> pd.DataFrame:
    """Return the identified numbers that differ clearly from nominal, the clearest first; without zeros that stand
    among the findings."""
    numbers, causes = (table_or_none(tables, name) for name in ("chain_parameters", "diagnosis"))
    if numbers is None:
        return pd.DataFrame()
    found_joints = set() if causes is None else set(causes["subject"][_is_found_zero(causes)])
    is_found = (numbers["parameter"] == "offset") & ("joint " + numbers["joint"]).isin(found_joints)
    numbers = numbers.assign(size=(numbers["identified"] / numbers["sigma"]).abs())
    is_clear = numbers["identifiable"] & (numbers["size"] > _CLEAR) & ~is_found
    return numbers[is_clear].sort_values("size", ascending=False)


def _is_found_zero(causes: pd.DataFrame) -> pd.Series:
    return (causes["cause"] == "joint-offset") & causes["verdict"].isin(("found", "suspected"))


def corrections(tables: Tables, adequacy: SectionVerdict | None) -> list[Verdict]:
    """Return the sentence on the numbers that differ clearly from nominal; empty if the model does not fit."""
    if adequacy is None:
        return []
    if adequacy.state != RelationState.OK and adequacy.reason_code != ReasonCode.BELOW_NOISE:
        return []
    clear = clear_numbers(tables)
    if clear.empty:
        return []
    named = listed([_number(row) for _, row in clear.iterrows()], _NAMED)
    errors = nominal_errors(tables)
    text = f"Corrections to the nominal geometry (section Chain): {named}"
    if errors is not None:
        nominal, identified = (quantity(size, errors.unit) for size in (errors.nominal, errors.identified))
        text += f"; with all that was identified, the rms error on {errors.poses} falls "
        text += f"from {nominal} with the nominal geometry to {identified}"
    text += "."
    return [("found", printed(text))]


@dataclass(frozen=True)
class NominalErrors:
    """Rms error of a chain as its description has it, base and tool fitted, and with all that was identified."""

    poses: str  # held-out or fitted ones
    nominal: float
    identified: float
    unit: str


def nominal_errors(tables: Tables) -> NominalErrors | None:
    """Return the errors on held-out poses, else on fitted ones; None where the description was taken for exact."""
    poses = table_or_none(tables, "prediction")
    if poses is None or "rms_nominal" not in poses:
        return None
    held_out = poses["role"].eq("verification")
    rows = poses[held_out if held_out.any() else ~held_out].dropna(subset=["rms_nominal", "rms_after"])
    if rows.empty:
        return None
    nominal, identified = (float(np.sqrt((rows[name] ** 2).mean())) for name in ("rms_nominal", "rms_after"))
    words = "held-out poses" if held_out.any() else "calibration poses"
    return NominalErrors(words, nominal, identified, str(rows["unit"].iloc[0]))


def _number(row: pd.Series) -> str:
    factor, unit = DEGREES.get(row["unit"], (1.0, row["unit"]))
    name = NAMES.get(row["parameter"], row["parameter"])
    size = with_uncertainty(factor * row["identified"], factor * row["sigma"])
    return f"{name} of {row['joint']} {size} {unit}"
