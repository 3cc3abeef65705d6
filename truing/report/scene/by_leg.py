"""Listing of measurements and parameters leg by leg, next to the 3-D view."""

from __future__ import annotations

import numpy as np
import pandas as pd

from truing.report.calibration.calibrations import calibration_name, displayed_calibration, rows_of
from truing.report.column_heads import LEG, Head
from truing.report.numbers import count_text, plain, with_uncertainty
from truing.report.page import Listing
from truing.report.parameter_names import kind_of, print_unit
from truing.report.tables import LOAD_UNITS, Tables, table_or_none

_HEADS = (
    LEG,
    Head("quantity", "Shift of the attachment, or parameter of the leg."),
    Head("value", "Estimate with one standard deviation."),
    Head("minus nominal", "Identified minus nominal value, with one standard deviation."),
    Head("pull", "Identified minus nominal value, divided by the standard deviation expected for this difference."),
)
_BENT = ("K", "kappa")


def by_leg(tables: Tables) -> Listing:
    """Return for each leg the shift of its attachment over all poses, and its parameters by the calibration shown."""
    shifts, fitted = table_or_none(tables, "deformation"), table_or_none(tables, "calibration")
    rows = [] if shifts is None or "leg" not in shifts else _shifts(shifts)
    caption = "Leg by leg: shifts of the attachment"
    if fitted is not None:
        key = displayed_calibration(tables, fitted)
        rows += _numbers(rows_of(fitted, key).dropna(subset=["leg"]))
        caption += f", and the parameters by {calibration_name(key)}. ±: one standard uncertainty"
    rows.sort(key=lambda row: row[0])
    return Listing(_HEADS, tuple((f"leg {leg}", *cells) for leg, *cells in rows), (), caption, True, by_leg=True)


def _shifts(shifts: pd.DataFrame) -> list[tuple]:
    used = shifts[~shifts["rejected"]] if "rejected" in shifts else shifts
    rows: list[tuple] = []
    for leg, group in used.groupby("leg"):
        shift, sigma = group["delta_bz_um"].to_numpy(dtype=float), group["sigma_um"].to_numpy(dtype=float)
        rms = float(np.sqrt(np.mean(shift**2)))
        # Contribution of the points' noise to the rms of these shifts, to first order.
        noise = float(np.sqrt(np.sum((shift * sigma) ** 2))) / (len(shift) * rms) if rms > 0.0 else float(sigma.max())
        most = int(np.argmax(np.abs(shift)))
        caption = f"largest shift of the attachment along z, pose {group['pose'].iloc[most]}"
        text = f"rms shift of the attachment along z over {count_text(len(group), 'pose')}"
        rows.append((int(leg), text, with_uncertainty(rms, noise, "µm"), "–", "–"))
        rows.append((int(leg), caption, with_uncertainty(float(shift[most]), float(sigma[most]), "µm"), "–", "–"))
    return rows


def _numbers(table: pd.DataFrame) -> list[tuple]:
    rows: list[tuple] = []
    for r in table.itertuples():
        factor, unit = print_unit(r.parameter, r.unit)
        named = kind_of(r.parameter, r.leg)
        value = with_uncertainty(factor * r.identified, factor * r.sigma, unit)
        bent = r.parameter.startswith(_BENT) or r.nominal != r.nominal
        less = "–" if bent else with_uncertainty(factor * (r.identified - r.nominal), factor * r.sigma, unit)
        pull = getattr(r, "pull", float("nan"))
        rows.append((int(r.leg), named, value, less, "–" if pull != pull else f"{pull + 0.0:.1f}"))
    return rows


def by_leg_of_sensor(tables: Tables) -> Listing:
    """Return for each leg of a sensor the column of G_B of its signal, and the deviations of its parts from nominal."""
    matrices, pulls = table_or_none(tables, "sensor_matrix"), table_or_none(tables, "pulls")
    rows: list[tuple] = []
    if matrices is not None:
        chosen = matrices[(matrices["matrix"] == "G_B") & matrices["chosen"]]
        for r in chosen[chosen["column_name"].str.fullmatch(r"v\d+")].itertuples():
            sigma = float(np.nanmax([r.sigma, getattr(r, "sigma_by_case", np.nan)]))
            value = with_uncertainty(r.value, sigma, f"{LOAD_UNITS[r.row]}/mV")
            rows.append((int(r.column_name[1:]), f"{r.row} per {r.column_name} in G_B", value, "–", "–"))
    if pulls is not None and "leg" in pulls:
        for r in pulls.dropna(subset=["leg", "pull_after"]).itertuples():
            rows.append((int(r.leg), kind_of(r.parameter, r.leg), "–", "–", plain(r.pull_after)))
    rows.sort(key=lambda row: row[0])
    caption = "Leg by leg: the column of G_B for its signal, and the pulls of its parts with the causes"
    return Listing(_HEADS, tuple((f"leg {leg}", *cells) for leg, *cells in rows), (), caption, True, by_leg=True)
