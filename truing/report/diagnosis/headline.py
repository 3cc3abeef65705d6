"""What was found in one clause that a busy person reads: who, what, how large; and what modelling it brings."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from truing.report.diagnosis.clause_parts import by, largest, most, moves, positive, told
from truing.report.diagnosis.compared import compared
from truing.report.diagnosis.effect_units import told_size
from truing.report.diagnosis.findings import subject_words
from truing.report.diagnosis.judged import Judged, columns_words
from truing.report.diagnosis.overall import overall
from truing.report.diagnosis.reach import Reach, reach
from truing.report.diagnosis.sensor_clauses import SENSOR_CLAUSES
from truing.report.numbers import printed, rough, sign, with_uncertainty

if TYPE_CHECKING:
    from truing.report.tables import Tables

# How many sizes a clause tells.
_TOLD = 3

# A shift is told with the sigma of parameters taken one by one where it is so many times that.
_TELLING = 2.0


def clause(row: Judged, tables: Tables) -> str:
    """What was found, without a full stop; in the words of its explanation where the cause is not the project's own."""
    if row.is_noise:
        return printed(_noise(row))
    said = _CLAUSES.get(row.cause, _in_own_words)(row, tables)
    return printed(said[:1].upper() + said[1:])


def gain(found: list[Judged], tables: Tables) -> str:
    """What modelling all that was found brings: ``brings verification errors from 34 to 8 µm, noise floor 7``."""
    told_of = overall(found, tables, held_out=True) or overall(found, tables, held_out=False)
    if told_of is None:
        return ""
    what = compared(tables).held_out_errors if told_of.held_out else "errors"
    floor = f", noise floor {rough(told_of.floor)}" if told_of.floor is not None else ""
    if told_of.is_below_noise:
        floor += f" (below it beyond chance: {told_of.why_below})"
    return f"{_change(what, told_of.before, told_of.after)} {sign(told_of.unit)}".rstrip() + floor


def _change(what: str, before: float, after: float) -> str:
    if rough(before) == rough(after):
        return f"leaves {what} at {rough(after)}"
    return f"{'brings' if after < before else 'takes'} {what} from {rough(before)} to {rough(after)}"


def _noise(row: Judged) -> str:
    size = row.size("noise_ratio")
    times = with_uncertainty(size.number or 0.0, size.sigma) if size is not None else "–"
    if row.follows:
        return f"The noise follows {columns_words(row.follows)} and is up to {times} times what was declared"
    whose = f" of {subject_words(row.subject)}" if row.subject else ""
    return f"The measurement{whose} is {times} times as noisy as declared"


def _actuators(row: Judged) -> str:
    """``actuator 3`` or ``actuators 1 and 4`` or ``the actuators``."""
    return subject_words(row.subject).replace("leg", "actuator", 1) or "the actuators"


def _one(row: Judged) -> bool:
    return bool(re.fullmatch(r"leg\d+", row.subject))


def _verb(row: Judged, one: str, many: str) -> str:
    return one if _one(row) else many


def _up_to(row: Judged, tables: Tables) -> str:
    found = reach(row, tables)
    return f", by up to {_far(found)}" if found is not None else ""


def _far(found: Reach) -> str:
    # Numbers that are known together alone would, taken one by one, leave a shift open that was measured.
    known = found.sigma is not None and 0.0 < found.sigma < found.largest / _TELLING
    return with_uncertainty(found.largest, found.sigma, "um") if known else f"{rough(found.largest)} um"


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
    sizes = {size.name.removeprefix("alpha").lstrip("_"): told(size) for size in row.sizes}
    if len(sizes) == 1:
        return f"base, platform and legs grow with temperature, by {next(iter(sizes.values()))}"
    return f"bodies grow with temperature: {', '.join(f'{part} {size}' for part, size in sizes.items())}"


def _base(row: Judged, tables: Tables) -> str:
    driver = row.size("driver")
    sizes = ", ".join(f"{s.name.replace('_', ' ')} {told(s)}" for s in row.sizes if s.number is not None)
    return f"the base deforms with {driver.value if driver else 'a drive'}: {sizes}"


def _gain_error(row: Judged, tables: Tables) -> str:
    size = largest(row.sizes_of("gain"))
    if not _one(row) or size is None:
        return f"{_actuators(row)} do not move by what they read{by(most(row, 'gain'))}"
    way = "further" if (size.number or 0.0) > 0.0 else "less far"
    return f"{_actuators(row)} moves {way} than it reads, by {told(positive(size))}"


def _backlash(row: Judged, tables: Tables) -> str:
    return f"{_actuators(row)} {_verb(row, 'has', 'have')} backlash{by(most(row, 'backlash'))} to either side"


def _periodic(row: Judged, tables: Tables) -> str:
    pitch = largest(row.sizes_of("pitch"))
    over = f", with a pitch of {told(pitch)}" if pitch is not None else ""
    return f"{_actuators(row)} {_verb(row, 'errs', 'err')} periodically{by(most(row, 'amplitude'))}{over}"


def _drift(row: Judged, tables: Tables) -> str:
    size = largest(row.sizes_of("drift"))
    where = subject_words(row.subject) or "the legs"
    if not _one(row) or size is None:
        return f"{where} drift in length over the campaign{by(most(row, 'drift'))}"
    way = "grows" if (size.number or 0.0) > 0.0 else "shrinks"
    return f"{where} {way} by {told(positive(size))} over the campaign"


def _warm_legs(row: Judged, tables: Tables) -> str:
    where = subject_words(row.subject) or "the legs"
    return f"{where} {_verb(row, 'grows', 'grow')} with temperature and the bodies do not{by(most(row, 'alpha'))}"


def _flexures(row: Judged, tables: Tables) -> str:
    size = largest(row.sizes_of("flexure_length"))
    long = f": {told(size)} long as beam theory has it" if size is not None else ""
    return f"the flexures shift the joints as they bend{long}"


def _scale(row: Judged, tables: Tables) -> str:
    per_k = row.size("scale_per_k")
    if per_k is not None:
        return f"measured lengths change with temperature, by {told(per_k)}"
    size = row.size("scale")
    way = "large" if size is not None and (size.number or 0.0) > 0.0 else "small"
    return f"measured lengths are too {way}{by(told(positive(size)) if size is not None else '')}"


def _moved(row: Judged, tables: Tables) -> str:
    parts = [size for name in ("dx", "dy", "dz") if (size := row.size(name)) is not None]
    apart = math.hypot(*(size.number or 0.0 for size in parts))
    sigma = max((size.sigma or 0.0 for size in parts), default=0.0)
    pose = row.size("from_pose")
    since = f" from pose {pose.value} on" if pose is not None else ""
    away = told_size("dx", apart, sigma or None, parts[0].unit if parts else "mm")
    return f"{row.subject or 'a target'} sits {away} from its place{since}"


def _swapped(row: Judged, tables: Tables) -> str:
    poses = row.size("poses")
    where = f" in poses {', '.join(str(poses.value).split())}" if poses is not None else ""
    return f"{subject_words(row.subject) or 'two targets'} carry each other's label{where}"


def _unexplained(row: Judged, tables: Tables) -> str:
    within = "in" if row.subject.startswith(("channel", "signal", "run")) else "at"
    where = f" {within} {subject_words(row.subject)}" if row.subject else ""
    what = columns_words(row.follows) or "none of the recorded columns"
    return f"something that no cause of the catalogue explains follows {what}{where}{moves(row)}"


def _of_sensor(said: Callable[[Judged], str], row: Judged, tables: Tables) -> str:
    return said(row)


def _in_own_words(row: Judged, tables: Tables) -> str:
    """The first clause of the explanation, and how large it is: its parameters, or where these are many, its reach."""
    said = re.sub("^(The data show|It may be) that ", "", row.explanation.partition(": ")[0]).rstrip(".")
    if len(row.sizes) > _TOLD and moves(row):
        return f"{said or row.name}{moves(row)}"
    sizes = ", ".join(f"{size.name} {told(size)}" for size in row.sizes[:_TOLD])
    return f"{said or row.name}: {sizes}" if sizes else said or row.name


_CLAUSES: dict[str, Callable[[Judged, Tables], str]] = {
    **{cause: partial(_of_sensor, said) for cause, said in SENSOR_CLAUSES.items()},
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
