"""Sentences on consistency tests: do two parts of a campaign match, and which slip explains a contradiction?"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from truing.belonging.relation import RecordSlip, RelationState, RelationTest, RotationForm, SlipKind
from truing.report.numbers import quantity

_MOST = 6  # subjects that a sentence lists
_SAME_FACTOR = 1e-6  # relative

# Names of the two sides of a relation in a sentence.
RELATIONS = {
    "readings-against-poses": "Actuator readings and measured poses",
    "joints-against-links": "Joint readings and measured links",
    "masses-against-lengths": "Masses, their centres and the lengths of the chain",
    "points-against-survey": "Measured points and their survey",
    "points-among-poses": "Measured points of the poses",
    "drives-against-poses": "Readings of the drive and measured rotations",
    "copied-poses": "Measured poses",
    "legs-regular": "The legs of [mechanism]",
    "loads-against-readings": "Loads and readings",
    "signals-against-loads": "Signals and loads",
    "copied-runs": "Runs",
}

_OF_RUNS = ("loads-against-readings", "signals-against-loads", "copied-runs")  # relations with comma-separated subjects
_OF_DESCRIPTION = ("loads-against-readings", "signals-against-loads")  # relations that [mechanism] predicts
_OF_READINGS = "readings-against-poses"
_GOOD = 10.0  # %, misfit that tolerances and gains usually leave
_FORCE_FACTORS = {
    1e3: "kN in place of N",
    1e-3: "N in place of kN, or mN in place of N",
    10.0: "daN in place of N",
    0.1: "N in place of daN",
    9.80665: "kgf in place of N",
    1.0 / 9.80665: "N in place of kgf",
    4.4482216152605: "lbf in place of N",
    1.0 / 4.4482216152605: "N in place of lbf",
}
# Names of factors by quantity: recorded unit, and right unit.
_FACTORS = {
    "length": {
        1e3: "metres in place of mm",
        1e-3: "µm in place of mm",
        10.0: "cm in place of mm",
        25.4: "inches in place of mm",
        1e6: "a factor of a million",
        0.5: "a diameter in place of a radius, or the way there and back",
        2.0: "a radius in place of a diameter, or half of the way",
    },
    "angle": {
        57.29577951308232: "radians in place of degrees",
        0.017453292519943295: "degrees in place of radians",
        0.9: "gon in place of degrees",
        1.0 / 0.9: "degrees in place of gon",
    },
    "mass": {1e-3: "g in place of kg", 1.0 / 9.80665: "N in place of kg"},
    "load": _FORCE_FACTORS | {1e3: "kN in place of N, kN m in place of N m"},
    "force": _FORCE_FACTORS,
    "torque": {
        1e3: "kN m in place of N m, or m in place of mm",
        10.0: "daN m in place of N m",
        0.1: "N m in place of daN m",
        9.80665: "kgf m in place of N m",
        1.0 / 9.80665: "N m in place of kgf m",
        0.00980665: "kgf mm in place of N m",
        1e-3: "N mm in place of N m",
        1.3558179483314: "lbf ft in place of N m",
        1.0 / 1.3558179483314: "N m in place of lbf ft",
        0.1129848290276: "lbf in in place of N m",
        1.0 / 0.1129848290276: "N m in place of lbf in",
        0.01: "N cm in place of N m",
    },
    "displacement": {
        1e3: "mm in place of µm, or m in place of mm",
        1e-3: "nm in place of µm, or µm in place of mm",
        1e6: "m in place of µm",
        25.4: "thousandths of an inch in place of µm, or inches in place of mm",
        25400.0: "inches in place of µm",
        2.0: "the interferometer is set to twice as many passes as its light makes",
        0.5: "the interferometer is set to half as many passes as its light makes",
    },
    "rotation": {
        206264.80624709636: "rad in place of arc seconds",
        3600.0: "degrees in place of arc seconds",
        60.0: "arc minutes in place of arc seconds",
        206.26480624709636: "mrad in place of arc seconds, or arc seconds in place of mrad",
        0.20626480624709636: "µrad in place of arc seconds",
    },
    "signal": {
        1e3: "V in place of mV",
        1e-3: "µV in place of mV, or mV in place of V",
        0.5: "twice the gain",
        2.0: "half the gain",
    },
}
# Quantities of columns by the units at the end of their names.
_ENDINGS = (("_mm", "length"), ("_deg", "angle"), ("_nm", "torque"), ("_n", "force"), ("_mv", "signal"))
_RUNS = ("run", "all")  # first words of subjects that are whole runs: run 2, all runs
_SEEN = (SlipKind.FROZEN, SlipKind.COPIED)  # slips that are evident in the numbers themselves
_REASONS = {
    "agrees": "belong together",
    "hardly-moved": "were not compared: the machine hardly moved",
    "no-masses": "were not compared: no masses are declared, or the chain is shorter than 0.2 m",
    "heavy-payload": "are unusual: the payload is heavier than all links together, and few arms carry so much",
    "centre-behind": "are unusual: the centre of mass lies behind the joint by more than a quarter of the link's "
    "length. com_mm counts from the joint (of a row: before its d, a and alpha); one that counts from the end of the "
    "row looks like this",
    "no-readings": "were not compared: the campaign has no actuator readings",
    "no-mechanism": "were not compared: no [mechanism] relates them",
    "no-survey": "were not compared: no survey says where the frames of base and platform lie",
    "no-inverse": "were not compared: this mechanism gives no reading for a pose",
    "no-poses": "were not compared: fewer than three poses have both",
    "unreached": "do not belong together: the legs of [mechanism] reach less than half of these poses at any reading",
    "tolerances": "were not compared: [mechanism.tolerance] allows errors as large as the range of these poses, so any "
    "readings would agree; measure poses further apart, or declare smaller tolerances",
    "no-frame": "were not compared: the targets fix no frame",
    "no-slip": "do not belong together, and no tested recording error explains it",
    "rounded": "belong together, but values were recorded in coarse steps",
    "late": "agree better if all readings are taken at another time",
    "strays": "belong together",
    "frames-differ": "do not belong together: positions and orientations of the measured poses are in different frames",
    "departs": "differ by more than a calibration usually explains",
    "legs-parallel": "are all parallel: they do not constrain sideways motion of the platform",
    "legs-alike": "have the same joints: together they constrain the platform like one leg",
    "legs-singular": "are singular: at the measured poses they do not constrain one motion of the platform",
    "regular": "constrain the platform in all six directions",
    "no-follower": "were not compared: no body rotates about one axis by the angle of the drive",
    "few-poses": "were not compared: fewer than three poses show three targets",
    "no-shape": "fit no common shape within their noise, and no tested recording error explains it: the body is not "
    "rigid, or the noise is larger than declared",
    "few-targets": "were not compared: fewer than three targets were seen",
    "no-fit": "do not agree, and neither a mirror image nor another unit explains it",
    "no-displacements": "were not compared: the campaign holds no readings of the platform's motion",
    "no-response": "were not compared: no run has changing loads and readings that respond to them",
    "no-main-response": "were not compared: no channel was read that should respond clearly",
    "no-repeats": "were not compared: no axis is loaded in three runs or more, and no simulation predicts the response",
    "one-pose": "were not compared: there is only one",
    "one-run": "were not compared: there is only one",
    "trace-of-range": "were not compared: the loads are only a very small part of the range in [loading]",
    "distinct": "are all different: none is a copy of another",
    "no-copies": "contain no copied rows (equal in every digit; tested: at least eight rows and a fifth of the shorter "
    "run)",
    "no-whole-copies": "differ: no two are equal in every digit. Copies of a part cannot be detected in these data",
    "coarse": "were not compared: the resolution of the file is coarser than the noise",
}


def message(tested: RelationTest) -> str:
    """Return the sentences for one tested relation: result, size, error that explains it, errors it cannot show."""
    names = tested.subject.split(", " if tested.relation in _OF_RUNS else None)
    subject = f" ({listed(names)})" if names and tested.subject else ""
    sides = f"{RELATIONS[tested.relation]}{subject}"
    if tested.slips and all(slip.kind in _SEEN for slip in tested.slips):
        part = any(slip.rows for slip in tested.slips)
        share = f", {tested.misfit:.0f} % of the shorter run" if part and tested.misfit is not None else ""
        words = listed([slip_words(slip) for slip in tested.slips], sep="; ")
        return f"{sides} are not all independent measurements: {words}{share}."
    if tested.reason == "rounded":
        error, noise = (f"{1e3 * (size or 0.0):.2g} µm" for size in (tested.misfit, tested.limit))
        words = "; ".join(map(slip_words, tested.slips))
        asked = " Are these commanded values in place of measured ones?" if tested.relation == _OF_READINGS else ""
        text = f"{sides} belong together, but: {words}. This causes an error of {error}; the declared noise is {noise}."
        return f"{text}{asked}"
    if tested.reason == "strays":
        return f"{sides} belong together{_size(tested)}, except {'; '.join(map(slip_words, tested.slips))}."
    if tested.reason == "scale":
        ratio = 1.0 / tested.slips[0].factor - 1.0
        text = f"{sides} agree in shape, but lengths between points are {1e3 * abs(ratio):.2g} mm/m "
        text += f"{'larger' if ratio > 0.0 else 'smaller'} than in the survey{_size(tested)}. With the survey in this "
        text += f"scale, the misfit is {quantity(tested.misfit_explained or 0.0, tested.unit)}. "
        return f"{text}Compare scale bars, refraction, and the temperatures of survey and measurement."
    if tested.slips and tested.state == RelationState.FAILS:
        return f"{sides} do not belong together{_size(tested)}. {_meant_words(tested)}"
    text = f"{sides} {_REASONS[tested.reason]}{_size(tested)}."
    if tested.slips:
        return f"{text} {_meant_words(tested)}"
    if tested.tried and tested.state in (RelationState.OK, RelationState.ATTENTION, RelationState.FAILS):
        text += f" Tested recording errors: {tested.tried}."
    if tested.hidden:
        text += f" Not detectable in this campaign: {listed([slip_words(slip) for slip in tested.hidden], sep='; ')}."
    return text


def _size(tested: RelationTest) -> str:
    if tested.misfit is None or tested.unit == "1":
        return ""
    limit = "" if tested.limit is None or tested.slips else f", limit {quantity(tested.limit, tested.unit)}"
    return f" (rms misfit {quantity(tested.misfit, tested.unit)}{limit})"


def _meant_words(tested: RelationTest) -> str:
    after = (
        ""
        if tested.misfit_explained is None
        else f" With this, the misfit is {quantity(tested.misfit_explained, tested.unit)}."
    )
    if tested.relation in _OF_DESCRIPTION and tested.unit == "%" and (tested.misfit_explained or 0.0) > _GOOD:
        after += " A good description leaves less: check the numbers of [mechanism], too."
    meant = f"Did you mean: {'; and '.join(slip_words(slip) for slip in tested.slips)}?"
    rivals = f" Equally likely: {'; or '.join(slip_words(slip) for slip in tested.rivals)}." if tested.rivals else ""
    return f"{meant}{after}{rivals}"


def slip_words(slip: RecordSlip) -> str:
    """Return one slip as a phrase: the recorded values and the correction."""
    return _WORDS[slip.kind](slip)


def _slip_subject(slip: RecordSlip) -> str:
    """Return quantity and subjects: ``reading dz, run 2`` of a column, ``reading of run 2`` of whole runs."""
    of_runs = bool(slip.subjects) and slip.subjects[0].partition(" ")[0] in _RUNS
    return f"{slip.quantity}{' of' if of_runs else ''} {listed(slip.subjects)}".strip()


def listed(names: Sequence[str], most: int = _MOST, sep: str = ", ") -> str:
    """Return the first names and the count of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{sep.join(names[:most])}{more}"


def _unit(slip: RecordSlip) -> str:
    if slip.factor == 1.0:
        return f"{_slip_subject(slip)} in another unit"
    quantity = slip.quantity if slip.quantity in _FACTORS else slip.dimension
    dimension = next((meaning for ending, meaning in _ENDINGS if slip.quantity.endswith(ending)), quantity)
    known = _FACTORS.get(dimension, {})
    named = [name for factor, name in known.items() if abs(slip.factor / factor - 1.0) < _SAME_FACTOR]
    name_text = f" ({named[0]})" if named else ""
    fault = "in another unit" if named else "off by a factor"
    return f"{_slip_subject(slip)} {fault}: multiply by {slip.factor:.7g}{name_text}"


def _zero(slip: RecordSlip) -> str:
    correction = f": add {slip.offset:.4g}" if slip.offset else ""
    return f"{_slip_subject(slip)} with another zero{correction}"


def _copied(slip: RecordSlip) -> str:
    text = f"{slip.quantity} {listed(slip.subjects)} are equal in every digit"
    if not slip.rows:
        return text
    ends = [at for at, row in enumerate(slip.rows) if row + 1 not in slip.rows[at + 1 : at + 2]]
    parts = [slip.rows[first:last] for first, last in pairwise([0, *(at + 1 for at in ends)])]
    spans = [f"{part[0]}" if len(part) == 1 else f"{part[0]} to {part[-1]}" for part in parts]
    return f"{text} in {len(slip.rows)} rows (of {slip.subjects[0]}: {listed(spans)})"


def _coupled(slip: RecordSlip, how: str, key: str) -> str:
    before, coupled = slip.subjects
    counted = "counted from a fixed direction, and not from the link before, as some controllers and parallelograms do"
    return f"{slip.quantity} {coupled} {counted}: {before} has to be {how} them (key {key} in columns of the mapping)"


_INVERSE = "as their inverses (the frame as seen from the body)"
_OTHER_END = "as quaternions with the scalar at the other end (w, x, y, z against x, y, z, w)"
_FORMS = {
    RotationForm.INVERSE: _INVERSE,
    RotationForm.INVERSION: f"{_INVERSE}, {_OTHER_END}, or as rotation vectors with two components exchanged or one of "
    "opposite sign (equivalent where base and tool are unknown)",
    RotationForm.BODY_AXES: "along the axes of the body (Rᵀp in place of p)",
    RotationForm.OF_INVERSE: "of the inverse poses (−Rᵀp in place of p)",
    RotationForm.SCALAR_AT_OTHER_END: _OTHER_END,
    RotationForm.VECTOR: "as rotation vectors, in place of Euler angles",
}


def _rotation(slip: RecordSlip) -> str:
    if slip.form is RotationForm.AXES:
        return f"{slip.quantity} with {', '.join(slip.order)} in the columns of x, y, z"
    assert slip.form is not None  # every slip of rotations has one
    rows = slip.subjects[1:]
    form = _FORMS.get(slip.form, f'as Euler angles in another order: [poses] euler = "{slip.order}"')
    return " ".join([slip.quantity, *([listed(rows)] if rows else []), form])


def _late(slip: RecordSlip) -> str:
    cure = "use times of one clock, or measure at standstill"
    causes = "clocks of two logs, or actuators that follow late"
    return f"{slip.quantity} {'late' if slip.offset > 0.0 else 'early'} by {abs(slip.offset):.3g} s ({causes}): {cure}"


# Where frames of base and platform lie, and the remedy, by what gave the poses.
_FRAMES_OF = {
    "measured poses": (
        {
            "base": "in the frame of the poses, that of a_mm lies at {place}",
            "platform": "in the frame of b_mm, that of the measured body lies at {place}",
        },
        "give the poses of the base too (body base), or transform poses or joints",
    ),
    "points and survey": (
        {
            "base": "in the base's frame of targets.csv, that of a_mm lies at {place}",
            "platform": "in the frame of b_mm, the platform's of targets.csv lies at {place}",
        },
        "give the survey of each body in the frame of its joints",
    ),
}


def _other_frame(slip: RecordSlip) -> str:
    names, cure = _FRAMES_OF.get(slip.quantity, _FRAMES_OF["measured poses"])
    places = []
    for body, numbers in slip.frames:
        at, turn = (" ".join(f"{number:g}" for number in part) for part in (numbers[:3], numbers[3:]))
        places.append(names[body].format(place=f"about ({at}) mm, rotated by ({turn}) deg"))
    return f"{slip.quantity} in other frames than a_mm and b_mm of [mechanism] ({', and '.join(places)}): {cure}"


_MIRROR = "mirrored (left-handed frame, one axis with the opposite sign, or two axes exchanged)"
_WORDS = {
    SlipKind.UNIT: _unit,
    SlipKind.SIGN: lambda slip: f"{_slip_subject(slip)} with the opposite sign",
    SlipKind.ZERO: _zero,
    SlipKind.COLUMNS: lambda slip: f"{slip.quantity} exchanged: {listed(slip.subjects)}",
    SlipKind.ROWS_SHIFTED: lambda slip: f"{_slip_subject(slip)} shifted by {slip.shift:+d} rows",
    SlipKind.ROWS_EXCHANGED: lambda slip: f"{slip.quantity} with exchanged rows: {listed(slip.subjects)}",
    SlipKind.MIRRORED: lambda slip: f"{_slip_subject(slip)} {_MIRROR}",
    SlipKind.PARTS_EXCHANGED: lambda slip: f"{slip.quantity} exchanged: {listed(slip.subjects)}",
    SlipKind.DIRECTION: lambda slip: f"{_slip_subject(slip)} pointing the opposite way",
    SlipKind.FROZEN: lambda slip: f"{_slip_subject(slip)} frozen: the value does not change while the machine moves",
    SlipKind.SILENT: lambda slip: (
        f"{_slip_subject(slip)} without response to the load: a channel that was not connected, whose beam missed its "
        "mirror, or that recorded something else"
    ),
    SlipKind.STRAY: lambda slip: (
        f"{_slip_subject(slip)} far from the pose: a misread digit, a value from another row, or a wrong point"
    ),
    SlipKind.ROUNDED: lambda slip: (
        f"{_slip_subject(slip)} recorded in steps of {slip.offset:.4g} mm, much larger than the noise"
    ),
    SlipKind.COPIED: _copied,
    SlipKind.ADDED: lambda slip: _coupled(slip, "added to", "plus"),
    SlipKind.SUBTRACTED: lambda slip: _coupled(slip, "subtracted from", "minus"),
    SlipKind.FRINGES: lambda slip: f"{_slip_subject(slip)} counted in fringes: multiply by {slip.factor:.7g} µm",
    SlipKind.MISLABELLED: lambda slip: f"{slip.quantity} recorded: {listed(slip.subjects)}",
    SlipKind.RELABELLED: lambda slip: (
        f"targets of {slip.subjects[-1]} under the names of others (in terms of the survey, "
        f"{listed(slip.subjects[:-1])})"
    ),
    SlipKind.SCALE: lambda slip: f"{_slip_subject(slip)} in another scale: multiply by {slip.factor:.5f}",
    SlipKind.CONVENTION: lambda slip: f'{slip.quantity} in the other convention: convention = "{slip.subjects[0]}"',
    SlipKind.ROTATION: _rotation,
    SlipKind.FRAME: lambda slip: (
        f"{_slip_subject(slip)} on in another frame (instrument or base moved): give both parts values of a column "
        'series, and set [measurement] frame = "series"'
    ),
    SlipKind.PLACED: lambda slip: (
        f"{_slip_subject(slip)} in another frame than that of the link: its targets lie elsewhere on the link "
        "(without a survey of this body, truing finds where)"
    ),
    SlipKind.OTHER_FRAME: _other_frame,
    SlipKind.LATE: _late,
    SlipKind.REVERSED: lambda slip: f"{_slip_subject(slip)} in reversed order, the last row first",
}
