"""What modelling the causes brings: predictions before and after, beside the noise and the plain calibrations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from truing.report.calibration.calibrations import DEFORMATIONS, EXTENDED, chosen_calibration, deformation_words
from truing.report.diagnosis import gain_figures
from truing.report.diagnosis.compared import POINTS, Compared, compared
from truing.report.diagnosis.judged import Judged, found_of, share_removed
from truing.report.diagnosis.overall import AT_THE_FLOOR, Overall, as_it_is, overall
from truing.report.diagnosis.reading_gain import by_channel, drawn_readings
from truing.report.diagnosis.reading_misses import reading_misses
from truing.report.diagnosis.resampled import rms_with_interval
from truing.report.numbers import plain, rough, sign
from truing.report.page import Listing, Section
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

Drawn = list[tuple[object, str]]
_NOT_FITTED = "which nothing was fitted to"
_ERROR = "position_error_um"


@dataclass(frozen=True)
class _Missed:
    """Rms of measured minus predicted over what ``words`` names; before is after where nothing was found."""

    words: str
    of: Overall
    modelled: bool

    @property
    def floor(self) -> float | None:
        """What noise alone leaves."""
        return self.of.floor


def gained(rows: list[Judged], tables: Tables) -> Section:
    """Measured minus predicted before and after, part by part and cause by cause, and how plain calibrations do.

    ``rows``: all candidates; where none was found, how far the simulation misses as it is.
    """
    found = [row for row in found_of(rows) if not row.is_noise]
    of = compared(tables)
    missed = _missed(rows, found, tables, of)
    told = [*_cause_by_cause(found, of), *_parts(missed, tables), *_plain(tables)]
    misses = reading_misses(tables)
    by_part = _by_role(tables) if misses is None else by_channel(misses)
    listings = [listing for listing in (by_part, _calibrations(tables)) if listing.rows]
    title = "Before and after" if found else "How far predictions miss"
    return Section("gain", title, _lead(missed, of, rows), tuple(told), tuple(listings), _state(missed))


def _missed(rows: list[Judged], found: list[Judged], tables: Tables, of: Compared) -> list[_Missed]:
    """What is missed on what was held out, then on the rest."""
    missed = []
    for held, words in ((True, f"{of.held_out}, {_NOT_FITTED}"), (False, of.fitted)):
        whole = overall(found, tables, held_out=held) if found else None
        told = [whole] if whole is not None else [] if found else as_it_is(rows, tables, held_out=held)
        missed += [_Missed(words, one, bool(found)) for one in told]
    return missed


def _state(missed: list[_Missed]) -> str:
    """Whether what is left is noise, and no less; not evaluated where nothing says what noise leaves."""
    if not missed or missed[0].floor is None:
        return "not evaluated"
    one = missed[0].of
    return "fail" if one.after > AT_THE_FLOOR * missed[0].floor or one.is_below_noise else "pass"


def _lead(missed: list[_Missed], of: Compared, rows: list[Judged]) -> str:
    """What is left on what nothing was fitted to, against the noise, and the share of the excess removed."""
    if not missed:
        return "Nothing says how far predictions miss."
    said = [_of_role(one) for one in missed]
    if not any(row.held_out[0] is not None for row in rows):
        said.append(f"No {of.whole} was held out, so nothing here was predicted before it was seen.")
    return " ".join(said)


def _of_role(missed: _Missed) -> str:
    one, unit = missed.of, sign(missed.of.unit)
    instead = f" instead of {rough(one.before)}" if missed.modelled else ""
    said = f"On the {missed.words}, predictions miss by {rough(one.after)} {unit} rms{instead}"
    if one.floor is None:
        return f"{said}."
    floor = f"the noise floor of {rough(one.floor)} {unit}"
    if one.is_below_noise:
        return f"{said}; that is below {floor}, less than chance explains: {one.why_below}."
    share = share_removed(one.before, one.after, one.floor) if missed.modelled else None
    gone = f", so {_per_cent(share)} of what is not noise is gone" if share is not None and share > 0.0 else ""
    ratio = one.after / one.floor
    verdict = "at" if 1.0 / AT_THE_FLOOR <= ratio <= AT_THE_FLOOR else f"{rough(ratio)} times"
    few = " Too few numbers tell whether chance leaves so little." if ratio < 1.0 / AT_THE_FLOOR else ""
    return f"{said}; that is {verdict} {floor}{gone}.{few}"


def _per_cent(share: float) -> str:
    return "all" if share > 0.9995 else f"{100.0 * share:.3g} %"


def _cause_by_cause(found: list[Judged], of: Compared) -> Drawn:
    rows = [row for row in found if row.rms[0] is not None and row.rms[1] is not None]
    units = dict.fromkeys(row.unit for row in rows)
    words = of.fitted_or_not
    if of is not POINTS:
        # Each is told over the channels that it moves: one does not go on where another ends.
        start = "with what was found before"
        return [(gain_figures.misses([row], of, *([start] if k else [])), words) for k, row in enumerate(rows)]
    return [(gain_figures.misses([row for row in rows if row.unit == unit], of), words) for unit in units]


def _parts(missed: list[_Missed], tables: Tables) -> Drawn:
    """Every pose, or every reading of a bench."""
    modelled = any(one.modelled for one in missed)
    misses = reading_misses(tables)
    if misses is not None:
        return drawn_readings(misses, modelled)
    table = filled(tables, "prediction")
    if table is None:
        return []
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
    for role, words in (("calibration", POINTS.fitted), ("verification", POINTS.held_out)):
        own = table[roles == role]
        if not len(own):
            continue
        sizes = [rms_with_interval(own[f"rms_{when}"], rng) for when in ("before", "after")]
        most = [plain(own[f"largest_{when}"].max()) for when in ("before", "after")]
        rows.append((words, str(len(own)), *sizes, *most, sign(str(own["unit"].iloc[0]))))
    caption = "Measured minus predicted over all poses; in brackets 95 % intervals from poses drawn again"
    return Listing(heads, tuple(rows), caption=caption, held_by="prediction.parquet")


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
            words,
            plain(_rms(own[_ERROR])),
            plain(own[_ERROR].max()),
            plain(_rms(own["position_noise_um"])) if "position_noise_um" in own else "–",
            "µm",
        )
        for name in dict.fromkeys(errors["called"])
        for role, words in (("calibration", POINTS.fitted), ("verification", POINTS.held_out))
        if len(own := errors[(errors["called"] == name) & (roles == role)])
    )
    return Listing(heads, rows, caption="Position of the platform, plain calibrations beside it", folded=True)


def _rms(values: pd.Series) -> float:
    known = values.dropna().to_numpy(dtype=float)
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
