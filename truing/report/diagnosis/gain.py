"""What modelling the causes brings: predictions before and after, beside the noise and the plain calibrations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from truing.report.calibration.calibrations import DEFORMATIONS, EXTENDED, chosen_calibration, deformation_words
from truing.report.diagnosis import gain_figures
from truing.report.diagnosis.judged import Judged, found_of, share_removed, whole_gain
from truing.report.diagnosis.words import AT_THE_FLOOR
from truing.report.numbers import plain, rough, sign
from truing.report.page import Listing, Section
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

Drawn = list[tuple[object, str]]
_HELD_OUT, _FITTED = "held-out poses, which nothing was fitted to", "calibration poses"
_ROLES = {"calibration": "calibration poses", "verification": "held-out poses"}
# Resampled campaigns behind an interval.
_DRAWS = 2000
_ERROR = "position_error_um"


@dataclass(frozen=True)
class _Missed:
    """Rms of measured minus predicted over the poses that ``words`` names; before is after where nothing was found."""

    words: str
    before: float
    after: float
    floor: float | None
    unit: str
    modelled: bool


def gained(rows: list[Judged], tables: Tables) -> Section:
    """Measured minus predicted before and after, pose by pose and cause by cause, and how plain calibrations do.

    ``rows``: all candidates; where none was found, how far the simulation misses as it is.
    """
    found = [row for row in found_of(rows) if not row.is_noise]
    missed = _missed(rows, found)
    told = [*_cause_by_cause(found), *_poses(missed, tables), *_plain(tables)]
    listings = [listing for listing in (_by_role(tables), _calibrations(tables)) if listing.rows]
    title = "Before and after" if found else "How far predictions miss"
    return Section("gain", title, _lead(missed), tuple(told), tuple(listings), _state(missed))


def _missed(rows: list[Judged], found: list[Judged]) -> list[_Missed]:
    """What is missed on held-out poses, then on the others."""
    told = found[-1:] or [row for row in rows if row.rms[0] is not None][:1]
    missed = []
    for held, words in ((True, _HELD_OUT), (False, _FITTED)):
        pair = whole_gain(found, held)
        if not found and told:
            as_it_is = (told[0].held_out if held else told[0].rms)[0]
            pair = None if as_it_is is None else (as_it_is, as_it_is)
        if pair is not None:
            missed.append(_Missed(words, *pair, told[0].floor, sign(told[0].unit), bool(found)))
    return missed


def _state(missed: list[_Missed]) -> str:
    """Whether what is left is noise; not evaluated where nothing says what noise leaves."""
    if not missed or missed[0].floor is None:
        return "not evaluated"
    return "pass" if missed[0].after <= AT_THE_FLOOR * missed[0].floor else "fail"


def _lead(missed: list[_Missed]) -> str:
    """What is left on poses that nothing was fitted to, against the noise, and the share of the excess removed."""
    if not missed:
        return "Nothing says how far predictions miss."
    said = [_of_role(one) for one in missed]
    if missed[0].words != _HELD_OUT:
        said.append("No pose was held out, so nothing here was predicted before it was seen.")
    return " ".join(said)


def _of_role(one: _Missed) -> str:
    instead = f" instead of {rough(one.before)}" if one.modelled else ""
    said = f"On the {one.words}, predictions miss by {rough(one.after)} {one.unit} rms{instead}"
    if one.floor is None:
        return f"{said}."
    share = share_removed(one.before, one.after, one.floor) if one.modelled else None
    gone = f", so {_per_cent(share)} of what is not noise is gone" if share is not None and share > 0.0 else ""
    verdict = "at" if one.after <= AT_THE_FLOOR * one.floor else f"{rough(one.after / one.floor)} times"
    return f"{said}; that is {verdict} the noise floor of {rough(one.floor)} {one.unit}{gone}."


def _per_cent(share: float) -> str:
    return "all" if share > 0.9995 else f"{100.0 * share:.3g} %"


def _cause_by_cause(found: list[Judged]) -> Drawn:
    rows = [row for row in found if row.rms[0] is not None and row.rms[1] is not None]
    units = dict.fromkeys(row.unit for row in rows)
    words = "Calibration poses were fitted to, held-out poses were not."
    return [(gain_figures.misses([row for row in rows if row.unit == unit]), words) for unit in units]


def _poses(missed: list[_Missed], tables: Tables) -> Drawn:
    table = filled(tables, "prediction")
    if table is None:
        return []
    modelled = any(one.modelled for one in missed)
    words = "Diamonds: held out, nothing was fitted to them."
    words = f"Each line joins a pose before and after. {words}" if modelled else words
    return [(gain_figures.pose_by_pose(table, missed[0].floor if missed else None, modelled), words)]


def _by_role(tables: Tables) -> Listing:
    """Rms and largest over the poses of each role, with intervals from resampled poses."""
    table = filled(tables, "prediction")
    heads = ("poses", "number", "rms before", "rms after", "largest before", "largest after", "unit")
    if table is None:
        return Listing(heads, ())
    rng = np.random.default_rng(0)
    roles = table["role"].replace("reference", "calibration")
    rows = []
    for role, words in _ROLES.items():
        own = table[roles == role]
        if not len(own):
            continue
        sizes = [_with_interval(own[f"rms_{when}"].to_numpy(dtype=float), rng) for when in ("before", "after")]
        most = [plain(own[f"largest_{when}"].max()) for when in ("before", "after")]
        rows.append((words, str(len(own)), *sizes, *most, sign(str(own["unit"].iloc[0]))))
    caption = "Measured minus predicted over all poses; in brackets 95 % intervals from poses drawn again"
    return Listing(heads, tuple(rows), caption=caption, held_by="prediction.parquet")


def _with_interval(rms: NDArray, rng: np.random.Generator) -> str:
    """Root of the mean square over poses, with the interval that drawing the poses again gives."""
    squares = rms[np.isfinite(rms)] ** 2
    if not len(squares):
        return "–"
    said = plain(float(np.sqrt(squares.mean())))
    if len(squares) < 3:
        return said
    drawn = np.sqrt(squares[rng.integers(0, len(squares), (_DRAWS, len(squares)))].mean(axis=1))
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{said} ({plain(float(low))} to {plain(float(high))})"


def _compared(tables: Tables) -> pd.DataFrame | None:
    """Errors of the plain calibrations of one model of the structure, and of the extended one, in their order."""
    accuracy = filled(tables, "accuracy")
    if accuracy is None:
        return None
    extended = accuracy[accuracy["model"] == EXTENDED]
    chosen = chosen_calibration(tables)
    models = [m for m in accuracy["model"].unique() if m != EXTENDED]
    if not models:
        return None
    model = chosen[0] if chosen is not None and chosen[0] in models else models[0]
    plain_ones = accuracy[(accuracy["model"] == model) & accuracy["deformation"].isin(DEFORMATIONS)]
    parts = [(f"plain, {deformation_words(d)}", plain_ones[plain_ones["deformation"] == d]) for d in DEFORMATIONS]
    parts.append(("extended model", extended))
    told = [part.assign(called=name) for name, part in parts if len(part)]
    import pandas

    return pandas.concat(told, ignore_index=True) if told else None


def _plain(tables: Tables) -> Drawn:
    errors = _compared(tables)
    if errors is None:
        return []
    words = "The same measurement by calibrations that know no cause but a deforming platform, geometry fitted to each."
    return [(gain_figures.beside_calibrations(errors), words)]


def _calibrations(tables: Tables) -> Listing:
    errors = _compared(tables)
    heads = ("calibration", "poses", "position rms", "largest", "noise alone", "unit")
    if errors is None:
        return Listing(heads, ())
    roles = errors["role"].replace("reference", "calibration")
    rows = tuple(
        (
            name,
            _ROLES[role],
            plain(_rms(own[_ERROR])),
            plain(own[_ERROR].max()),
            plain(_rms(own["position_noise_um"])) if "position_noise_um" in own else "–",
            "µm",
        )
        for name in dict.fromkeys(errors["called"])
        for role in _ROLES
        if len(own := errors[(errors["called"] == name) & (roles == role)])
    )
    return Listing(heads, rows, caption="Position of the platform, plain calibrations beside it", folded=True)


def _rms(values: pd.Series) -> float:
    known = values.dropna().to_numpy(dtype=float)
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
