"""Positioning of an axis by ISO 230-2, as table rows."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.iso230 import Positioning, positioning, positioning_uncertainty
from truing.stages.common.belonging import subject_of
from truing.stages.common.positioning import SEED, deviations, instrument
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.interferometer import Interferometer

Array = NDArray[np.float64]

_UM = 1e3  # per mm
_WAYS = ("forward", "backward")


def positioning_rows(positions: pa.Table, optics: Interferometer, withheld: Collection[str] = ()) -> Rows:
    """Every quantity of every run, um; those of the axis with their uncertainty where it is told.

    ``withheld``: subjects of runs (as quality names them) of which nothing may be stated.
    """
    rows = Rows("positioning")
    names = positions.column("run").to_pylist()
    runs = np.array([str(name) for name in names], dtype=object)
    for run in dict.fromkeys(names):
        if subject_of(run) in withheld:
            continue
        own = positions.filter((runs == str(run)).tolist())
        target, deviation = deviations(own)
        found = positioning(deviation)
        _of_targets(rows, run, target, found)
        _of_axis(rows, run, found)
        known = positioning_uncertainty(deviation, target * _UM, np.random.default_rng(SEED), instrument(own, optics))
        for figure, one in known.items():
            _add(rows, run, figure, None, one.value, sigma=one.sigma, low=one.low, high=one.high)
    return rows


def told(rows: pa.Table, withheld: Mapping[str, str]) -> str:
    """The accuracy of every run in words, and why that of others is not evaluated."""
    found = [
        f"{row['run']}: A {row['value']:.3g} um, B {_value(rows, row['run'], 'B'):.3g} um"
        for row in rows.to_pylist()
        if row["figure"] == "A" and row["subject"] is None
    ]
    found += [f"not evaluated: {why}" for why in withheld.values()]
    return f"positioning by ISO 230-2: {'; '.join(found)}"


def _value(rows: pa.Table, run: int | str, figure: str) -> float:
    return float(
        next(
            row["value"]
            for row in rows.to_pylist()
            if (row["run"], row["figure"], row["subject"]) == (run, figure, None)
        )
    )


def _of_targets(rows: Rows, run: int | str, target: Array, found: Positioning) -> None:
    for place, at in enumerate(target):
        subject = f"{at:g} mm"
        for way, name in enumerate(_WAYS):
            _add(rows, run, f"mean_{name}", subject, found.mean[place, way])
            _add(rows, run, f"s_{name}", subject, found.scatter[place, way])
            _add(rows, run, f"R_{name}", subject, found.repeatability_at[place, way])
        _add(rows, run, "B", subject, found.reversal_at[place])
        _add(rows, run, "R", subject, found.bidirectional_at[place])


def _of_axis(rows: Rows, run: int | str, found: Positioning) -> None:
    _add(rows, run, "B_mean", None, float(found.mean_reversal))
    for way, name in enumerate(_WAYS):
        _add(rows, run, f"R_{name}", None, found.repeatability[way])
        _add(rows, run, f"E_{name}", None, found.systematic[way])
        _add(rows, run, f"A_{name}", None, found.accuracy[way])


def _add(rows: Rows, run: int | str, figure: str, subject: str | None, value: float, **more: float) -> None:
    rows.add(run=run, figure=figure, subject=subject, value=float(value), unit="um", **more)
