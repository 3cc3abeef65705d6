"""What was found in one clause that a busy person reads: who, what, how large; and what modelling it brings."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import TYPE_CHECKING

from truing.report.diagnosis.effect_units import told_size
from truing.report.diagnosis.findings import reach_of, subject_words
from truing.report.diagnosis.judged import Judged, Size, columns_words, whole_gain
from truing.report.diagnosis.reach import reach
from truing.report.numbers import printed, rough, sign, with_uncertainty

if TYPE_CHECKING:
    from truing.report.tables import Tables

# How many sizes a clause tells.
_TOLD = 3


def clause(row: Judged, tables: Tables) -> str:
    """What was found, without a full stop; in the words of its explanation where the cause is not the project's own."""
    if row.is_noise:
        return printed(_noise(row))
    said = _CLAUSES.get(row.cause, _in_own_words)(row, tables)
    return printed(said[:1].upper() + said[1:])


def gain(found: list[Judged]) -> str:
    """What modelling all that was found brings: ``brings verification errors from 34 to 8 µm, noise floor 7``."""
    held = whole_gain(found, True)
    pair = held or whole_gain(found, False)
    if pair is None:
        return ""
    last = [row for row in found if not row.is_noise][-1]
    floor = f", noise floor {rough(last.floor)}" if last.floor is not None else ""
    what = "verification errors" if held else "errors"
    return f"{_change(what, *pair)} {sign(last.unit)}".rstrip() + floor


def _change(what: str, before: float, after: float) -> str:
    if rough(before) == rough(after):
        return f"leaves {what} at {rough(after)}"
    return f"{'brings' if after < before else 'takes'} {what} from {rough(before)} to {rough(after)}"


def _noise(row: Judged) -> str:
    size = row.size("noise_ratio")
    times = with_uncertainty(size.number or 0.0, size.sigma) if size is not None else "–"
    if row.follows:
        return f"The noise follows {columns_words(row.follows)} and is up to {times} times what was declared"
    return f"The measurement is {times} times as noisy as declared"


def _told(size: Size) -> str:
    return told_size(size.name, size.value, size.sigma, size.unit)


def _largest(sizes: tuple[Size, ...]) -> Size | None:
    return max(sizes, key=lambda size: abs(size.number or 0.0), default=None)


def _leg_of(size: Size, subject: str) -> str:
    """``leg 3``: whose parameter it is, by its suffix or by the subject."""
    numbered = re.search(r"_(\d+)$", size.name)
    return f"leg {numbered[1]}" if numbered else subject_words(subject)


def _most(row: Judged, kind: str) -> str:
    """``0.21 ± 0.01 %``, or where several legs have their own, ``most leg 3 (0.21 ± 0.01 %)``."""
    sizes = row.sizes_of(kind)
    size = _largest(sizes)
    if size is None:
        return ""
    return _told(size) if len(sizes) == 1 else f"most {_leg_of(size, row.subject)} ({_told(size)})"


def _by(words: str) -> str:
    return "" if not words else f", {words}" if words.startswith("most ") else f", by {words}"


def _actuators(row: Judged) -> str:
    """``actuator 3`` or ``actuators 1 and 4`` or ``the actuators``."""
    return subject_words(row.subject).replace("leg", "actuator", 1) or "the actuators"


def _one(row: Judged) -> bool:
    return bool(re.fullmatch(r"leg\d+", row.subject))


def _verb(row: Judged, one: str, many: str) -> str:
    return one if _one(row) else many


def _up_to(row: Judged, tables: Tables) -> str:
    found = reach(row, tables)
    return f", by up to {rough(found.largest)} um" if found is not None else ""


def _deforms(row: Judged, tables: Tables) -> str:
    """The platform follows each leg's own actuator."""
    found = reach(row, tables)
    where = subject_words(row.subject)
    out = " out of proportion to" if row.cause.endswith("nonlinear") else " with"
    if where:
        return f"the platform deforms at {where}{out} its own actuator{_up_to(row, tables)}"
    most = f", most at leg {found.legs[0]}" if found is not None else ""
    return f"the platform deforms at each leg{out} that leg's actuator{most}{_up_to(row, tables)}"


def _deforms_with_all(row: Judged, tables: Tables) -> str:
    found = reach(row, tables)
    most = f", most between legs {found.legs[0]} and {found.legs[1]}" if found is not None else ""
    return f"the platform deforms with the actuators{most}{_up_to(row, tables)}"


def _heat(row: Judged, tables: Tables) -> str:
    told = {size.name.removeprefix("alpha").lstrip("_"): _told(size) for size in row.sizes}
    if len(told) == 1:
        return f"base, platform and legs grow with temperature, by {next(iter(told.values()))}"
    return f"bodies grow with temperature: {', '.join(f'{part} {size}' for part, size in told.items())}"


def _base(row: Judged, tables: Tables) -> str:
    driver = row.size("driver")
    sizes = ", ".join(f"{s.name.replace('_', ' ')} {_told(s)}" for s in row.sizes if s.number is not None)
    return f"the base deforms with {driver.value if driver else 'a drive'}: {sizes}"


def _gain_error(row: Judged, tables: Tables) -> str:
    size = _largest(row.sizes_of("gain"))
    if not _one(row) or size is None:
        return f"{_actuators(row)} do not move by what they read{_by(_most(row, 'gain'))}"
    way = "further" if (size.number or 0.0) > 0.0 else "less far"
    return f"{_actuators(row)} moves {way} than it reads, by {_told(_positive(size))}"


def _positive(size: Size) -> Size:
    return Size(size.name, abs(size.number or 0.0), size.sigma, size.unit)


def _backlash(row: Judged, tables: Tables) -> str:
    return f"{_actuators(row)} {_verb(row, 'has', 'have')} backlash{_by(_most(row, 'backlash'))} to either side"


def _periodic(row: Judged, tables: Tables) -> str:
    pitch = _largest(row.sizes_of("pitch"))
    over = f", with a pitch of {_told(pitch)}" if pitch is not None else ""
    return f"{_actuators(row)} {_verb(row, 'errs', 'err')} periodically{_by(_most(row, 'amplitude'))}{over}"


def _drift(row: Judged, tables: Tables) -> str:
    size = _largest(row.sizes_of("drift"))
    where = subject_words(row.subject) or "the legs"
    if not _one(row) or size is None:
        return f"{where} drift in length over the campaign{_by(_most(row, 'drift'))}"
    way = "grows" if (size.number or 0.0) > 0.0 else "shrinks"
    return f"{where} {way} by {_told(_positive(size))} over the campaign"


def _warm_legs(row: Judged, tables: Tables) -> str:
    where = subject_words(row.subject) or "the legs"
    return f"{where} {_verb(row, 'grows', 'grow')} with temperature and the bodies do not{_by(_most(row, 'alpha'))}"


def _flexures(row: Judged, tables: Tables) -> str:
    size = _largest(row.sizes_of("flexure_length"))
    long = f": {_told(size)} long as beam theory has it" if size is not None else ""
    return f"the flexures shift the joints as they bend{long}"


def _scale(row: Judged, tables: Tables) -> str:
    per_k = row.size("scale_per_k")
    if per_k is not None:
        return f"measured lengths change with temperature, by {_told(per_k)}"
    size = row.size("scale")
    way = "large" if size is not None and (size.number or 0.0) > 0.0 else "small"
    return f"measured lengths are too {way}{_by(_told(_positive(size)) if size is not None else '')}"


def _moved(row: Judged, tables: Tables) -> str:
    parts = [size for name in ("dx", "dy", "dz") if (size := row.size(name)) is not None]
    apart = math.hypot(*(size.number or 0.0 for size in parts))
    sigma = max((size.sigma or 0.0 for size in parts), default=0.0)
    pose = row.size("from_pose")
    since = f" from pose {pose.value} on" if pose is not None else ""
    told = told_size("dx", apart, sigma or None, parts[0].unit if parts else "mm")
    return f"{row.subject or 'a target'} sits {told} from its place{since}"


def _swapped(row: Judged, tables: Tables) -> str:
    poses = row.size("poses")
    where = f" in poses {', '.join(str(poses.value).split())}" if poses is not None else ""
    return f"{subject_words(row.subject) or 'two targets'} carry each other's label{where}"


def _unexplained(row: Judged, tables: Tables) -> str:
    where = f" at {subject_words(row.subject)}" if row.subject else ""
    what = columns_words(row.follows) or "none of the recorded columns"
    return f"something that no cause of the catalogue explains follows {what}{where}{_moves(row)}"


def _moves(row: Judged) -> str:
    largest = reach_of(row.explanation)
    return f", by up to {rough(largest[0])} {largest[1]}" if largest is not None else ""


def _in_own_words(row: Judged, tables: Tables) -> str:
    """The first clause of the explanation, and how large it is: its parameters, or where these are many, its reach."""
    said = row.explanation.partition(": ")[0].removeprefix("The data show that ").rstrip(".")
    if len(row.sizes) > _TOLD and _moves(row):
        return f"{said or row.name}{_moves(row)}"
    sizes = ", ".join(f"{size.name} {_told(size)}" for size in row.sizes[:_TOLD])
    return f"{said or row.name}: {sizes}" if sizes else said or row.name


_CLAUSES: dict[str, Callable[[Judged, Tables], str]] = {
    "platform-deformation-linear": _deforms,
    "platform-deformation-nonlinear": _deforms,
    "platform-deformation-matrix": _deforms_with_all,
    "thermal-expansion": _heat,
    "base-deformation": _base,
    "actuator-gain": _gain_error,
    "actuator-backlash": _backlash,
    "actuator-periodic-error": _periodic,
    "leg-drift": _drift,
    "leg-thermal": _warm_legs,
    "flexure-shift": _flexures,
    "measurement-scale": _scale,
    "target-moved": _moved,
    "targets-swapped": _swapped,
    "unexplained": _unexplained,
}
