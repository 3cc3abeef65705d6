"""Wordings of causes on a bench: loads, sensor, beams, counters and signals."""

from __future__ import annotations

import re

from truing.report.diagnosis.findings import subject_words
from truing.report.wordings.claim import (
    Claim,
    ParameterSize,
    Wording,
    determined_sizes,
    largest,
    largest_of_kind,
    listed,
    positive,
    size_in_words,
)

_ALONG = {"fx": "x", "fy": "y", "fz": "z", "mx": "x", "my": "y", "mz": "z"}
_ALL_CHANNELS = "all linear channels"
# Shares of two units that change with the load, and between which loads.
_SHARES = {
    "share_asymmetry": "under positive loads than under negative ones",
    "share_growth": "at the largest load than at small ones",
}
_OF_COLUMN = {
    "per_k_material": ("material_temperature_c", "the temperature of the material"),
    "per_k_air": ("air_temperature_c", "the temperature of the air"),
}


def _axis(claim: Claim) -> str:
    """Return the axis of a claim: ``fz`` of ``load fz``; empty for all axes."""
    match = re.search(r"\bload (\w+)", claim.subject)
    return match[1] if match else ""


def load_words(axis: str, article: str = "the ", plural: bool = False) -> str:
    """Return ``the z load``, ``torques about x``; a word of the lab's own as it is; ``loads`` for all axes."""
    ending = "s" if plural else ""
    if axis not in _ALONG:
        return f"{article}load{ending} {axis}".rstrip()
    return (
        f"{article}{_ALONG[axis]} load{ending}" if axis[0] == "f" else f"{article}torque{ending} about {_ALONG[axis]}"
    )


def _loads(claim: Claim) -> str:
    """Return ``z loads``; ``load`` for all axes."""
    return load_words(_axis(claim), "", plural=True) if _axis(claim) else "load"


def _under_loads(claim: Claim) -> str:
    of_own_component = " (in their own component alone)" if claim.fact("own") else ""
    return f"under {_loads(claim)}{of_own_component}"


def _parts(claim: Claim) -> dict[str, str]:
    """Return run, channel and signal of a subject."""
    return dict(re.findall(r"\b(run|channel|signal) (\S+)", claim.subject))


def _channel(claim: Claim, otherwise: str = _ALL_CHANNELS) -> str:
    parts = _parts(claim)
    return next((f"{kind} {parts[kind]}" for kind in ("channel", "signal") if kind in parts), otherwise)


def _subject_words(claim: Claim, otherwise: str) -> str:
    """Return the channel, signal or run of a cause: ``channel dz``, ``channel dz in run 4``."""
    parts, name = _parts(claim), _channel(claim, "")
    if "run" not in parts:
        return name or otherwise
    return f"{name} in run {parts['run']}" if name else f"run {parts['run']}"


def _shift_words(size: ParameterSize) -> str:
    """Return a shift with its direction: ``12.0 ± 0.1 mm towards +x``."""
    return f"{size_in_words(positive(size))} towards {_direction(size)}"


def _all_towards(sizes: list[ParameterSize]) -> str:
    return " and ".join(map(_shift_words, sizes))


def _direction(size: ParameterSize) -> str:
    return f"{'−' if (size.number or 0.0) < 0.0 else '+'}{size.name.partition('_')[2][:1]}"


def _eccentric(claim: Claim) -> str:
    axis, sizes = _axis(claim), determined_sizes(claim.sizes)
    if axis.startswith("m"):
        return f"{load_words(axis)} also applies a force{': ' if sizes else ''}{_all_towards(sizes)}"
    who, verb = (load_words(axis), "acts") if axis else ("the forces", "act")
    if len(sizes) == 1:
        return f"{who} {verb} {size_in_words(positive(sizes[0]))} off the origin, towards {_direction(sizes[0])}"
    return f"{who} {verb} off the origin{': ' if sizes else ''}{_all_towards(sizes)}"


def _shift_load(claim: Claim) -> str:
    axis = _axis(claim)
    if axis.startswith("m"):
        measured = f"Measure with a load cell the force that acts with the torque {axis}"
        return f"{measured}, or turn the torque unit by 180 degrees."
    load_text = f"the load {axis}" if axis else "the loading frame"
    turns = " and ".join(f"r{c}" for c in "xyz" if c != axis[1:]) if axis else "all rotations"
    return f"Shift {load_text} sideways by a known distance of about 1 mm and repeat the run, with {turns} measured."


def _imbalance(claim: Claim) -> str:
    """Return the part that differs between directions or grows with the load first; a proportional part is an
    eccentricity."""
    differs = [
        size for size in claim.sizes if size.name.endswith(("_asymmetry", "_growth")) and size.number is not None
    ]
    shown = largest(tuple(differs or claim.sizes))
    who = load_words(_axis(claim))
    if shown is None:
        return f"the units that apply {who} are not balanced"
    if share := next((size for size in claim.sizes if size.name in _SHARES and size.number is not None), None):
        more = "more" if (share.number or 0.0) > 0.0 else "less"
        return f"the first unit takes {size_in_words(positive(share))} of {who} {more} {_SHARES[share.name]}"
    load, component = shown.name.split("_")[:2]
    brought = f"a parasitic {load} {'about' if load == 'moment' else 'along'} {component}"
    size = size_in_words(positive(shown))
    if shown.name.endswith("_growth"):
        return f"{who} causes {brought} that grows nonlinearly, by {size} at the largest load"
    if shown.name.endswith("_asymmetry"):
        differs_text = f"{who} causes {brought} that differs by {size} between positive and negative load"
        return f"{differs_text}{_lines_apart(_axis(claim), shown)}"
    return f"{who} causes {brought}: {size}"


def _arm_direction(axis: str, about: str) -> tuple[str, float]:
    """Return the axis along which an offset of a force causes a moment about a given axis, and the sign of the arm.

    The sign is that for a positive moment. The axis is empty for torques and for a moment about the force itself.
    """
    along = axis[-1:]
    if not axis.startswith("f") or along == about:
        return "", 0.0
    (across,) = {*"xyz"} - {along, about}
    return across, 1.0 if across + along + about in "xyzxy" else -1.0  # moment = arm x force


def _lines_apart(axis: str, moment: ParameterSize) -> str:
    """Return the lever arm at the stand that a difference of moments means: lines of action of both signs lie apart."""
    across, sign = _arm_direction(axis, moment.name.split("_")[1])
    if not across:
        return ""
    sigma = None if moment.sigma is None else 1e3 * moment.sigma
    arm = ParameterSize(f"offset_{across}", 1e3 * sign * (moment.number or 0.0), sigma, "mm")
    return f", as if the positive load acted {size_in_words(positive(arm))} further towards {_direction(arm)}"


def _one_unit(claim: Claim) -> str:
    axis = _axis(claim)
    arms = [_arm_direction(axis, about)[0] for about in claim.fact("components") or ()]
    if "_asymmetry" in (claim.fact("forms") or ()) and any(arms):
        return (
            f"Measure at the loading stand where the lines of action of positive and of negative {axis} pass along "
            f"{' and '.join(filter(None, arms))}. Where only signals are recorded, they do not show which of the two "
            "is off the axis."
        )
    if axis.startswith("m"):  # one unit alone gives no couple
        return f"Exchange the two units of {axis} and repeat the run: the parasitic force should change its sign."
    return f"Drive {axis} with one unit at a time, pushing and pulling, and compare rotations and displacements."


def _stiffness(claim: Claim) -> str:
    size, more = largest_of_kind(claim, "scale")
    if not size:
        return f"the sensor's stiffness {_under_loads(claim)} differs from the simulated one by a factor"
    return f"the sensor is {size} {'stiffer' if more else 'softer'} {_under_loads(claim)} than simulated"


def _soft_leg(claim: Claim) -> str:
    size, more = largest_of_kind(claim, "scale")
    part = claim.fact("part")
    part_text = f"{part} of {subject_words(claim.subject)}" if part else subject_words(claim.subject)
    if not size:
        return f"the stiffness of {part_text} differs from the simulated one"
    return f"{part_text} is {size} {'stiffer' if more else 'softer'} than simulated"


def _swap_legs(claim: Claim) -> str:
    leg = subject_words(claim.subject)
    return f"Exchange {leg} for another one and repeat the runs: the stiffness error should move with it."


def _asymmetry(claim: Claim) -> str:
    size, more = largest_of_kind(claim, "asymmetry")
    if not size:
        return f"the sensor deflects more {_under_loads(claim)} of one sign than of the other"
    softer, stiffer = ("positive", "negative") if more else ("negative", "positive")
    loads = load_words(_axis(claim), "", plural=True)
    return f"the sensor deflects {size} more under {softer} {loads} than under {stiffer} ones"


def _nonlinear(claim: Claim) -> str:
    size, more = largest_of_kind(claim, "cubic")
    gives = f": at the largest load it deflects {size} {'more' if more else 'less'} than linear" if size else ""
    return f"the sensor is not linear {_under_loads(claim)}{gives}"


def _hysteresis(claim: Claim) -> str:
    size, more = largest_of_kind(claim, "width")
    if not size:
        return f"the deflection {_under_loads(claim)} differs between loading and unloading"
    verb = "lags" if more else "leads"
    return f"the deflection {_under_loads(claim)} {verb} on unloading, by {size} of the largest at half load"


def _drag(claim: Claim) -> str:
    size, _ = largest_of_kind(claim, "width")
    if not size:
        return f"the deflection {_under_loads(claim)} lags the load and keeps a remainder without load"
    turns, threshold = "", claim.size("threshold")
    if threshold is not None and threshold.number:
        width = size_in_words(ParameterSize("width", 2.0 * threshold.number, None, "1"))
        turns = f", and reverses over {width} of the range"
    return (
        f"the deflection {_under_loads(claim)} lags the load and keeps a remainder without load, {size} of its "
        f"largest{turns}"
    )


def _signals_lag(claim: Claim) -> str:
    size, more = largest_of_kind(claim, "width")
    comparative = "larger" if more else "smaller"
    differ = (
        f" are {comparative} on the way back, by {size} of the largest signal" if size else " differ on the way back"
    )
    closes = claim.settings.get("threshold") == 0.0
    keeps = "without load the difference vanishes" if closes else "a remainder stays without load"
    return f"the signals {_under_loads(claim)}{differ} (hysteresis); {keeps}"


def _play(claim: Claim) -> str:
    size, _ = largest_of_kind(claim, "clearance")
    jumps = f"jumps by {size}" if size else "jumps"
    return f"the joints have clearance: the platform {jumps} when {load_words(_axis(claim))} changes its sign"


def _through_zero(claim: Claim) -> str:
    axis = _axis(claim) or "the load"
    return f"Pass {axis} through zero in ten small steps, and again with an additional constant load."


def _creep(claim: Claim) -> str:
    size, more = largest_of_kind(claim, "fraction")
    tau = claim.size("tau")
    pace = f", with a time constant of {size_in_words(tau)}" if tau is not None else ""
    size_text = f", by {size} of its deflection" if size else ""
    moves = "creeps" if not size else "creeps on" if more else "creeps back"
    return f"the sensor {moves} under {_loads(claim)}{size_text}{pace}"


def _zero_drift_clause(claim: Claim) -> str:
    size, up = largest_of_kind(claim, "rate")
    drift_text = f" {'up' if up else 'down'}, by {size}" if size else " linearly with time"
    return f"the zero of {_subject_words(claim, 'the channels')} drifts{drift_text}"


def _unloaded(claim: Claim) -> str:
    return f"Read {_channel(claim)} without load for as long as a run takes, and return to zero in every run."


def _warm(claim: Claim) -> str:
    changes = [f"{_OF_COLUMN[s.name][1]} by {size_in_words(s)}" for s in claim.sizes if s.name in _OF_COLUMN]
    columns = claim.fact("columns") or ()
    plain = [words for column, words in _OF_COLUMN.values() if column in columns]
    driver = " and ".join(changes or plain) or "the temperature"
    return f"{_subject_words(claim, 'every linear channel')} depends on {driver}"


def _zero_against_temperature(claim: Claim) -> str:
    return f"Read {_channel(claim)} without load while the room is warmed by 1 K and cools down again."


def _tilted(claim: Claim) -> str:
    size, _ = largest_of_kind(claim, "angle")
    tilts = determined_sizes(tuple(size for size in claim.sizes if size.name.startswith("tilt_")))
    towards = (
        f": {' and '.join(f'{size_in_words(positive(tilt))} towards {_tilt_direction(tilt)}' for tilt in tilts)}"
        if tilts
        else ""
    )
    beam = f"the beam of {_subject_words(claim, 'a channel')}"
    return f"{beam} is tilted{f' by {size}' if size else ''} from its axis{towards}"


def _tilt_direction(tilt: ParameterSize) -> str:
    """Return ``+dy`` for a tilt towards the axis of channel dy."""
    return f"{'−' if (tilt.number or 0.0) < 0.0 else '+'}{tilt.name.removeprefix('tilt_')}"


def _align(claim: Claim) -> str:
    return f"Align the beam of {_channel(claim)} over a longer travel along its axis, and repeat the run."


def _arm(claim: Claim) -> str:
    sizes = determined_sizes(claim.sizes)
    arm = f": {_all_towards(sizes)}" if sizes else ""
    beam = f"the beam of {_subject_words(claim, 'every linear channel')}"
    return f"{beam} passes off the origin{arm}, so it measures rotation too"


def _shift_beam(claim: Claim) -> str:
    return f"Shift the beam of {_channel(claim)} sideways by a known distance of about 1 mm and repeat the run."


def _dead_path(claim: Claim) -> str:
    size = claim.size("dead_path")
    long = f" of {size_in_words(size)}" if size is not None else ""
    return f"{_subject_words(claim, 'every linear channel')} has a dead path{long} without compensation for the air"


def _slip(claim: Claim) -> str:
    count, since = claim.size("count"), claim.since("step")
    shift = claim.size("shift")
    if shift is not None:
        who = _subject_words(claim, "a counter")
        size = size_in_words(shift)
        return f"the zero of {who} shifts by {size}{since}, which is not a whole number of half wavelengths"
    if count is None or count.number is None:
        return f"{_subject_words(claim, 'a counter')} jumps by whole half wavelengths{since}"
    number = int(count.number)
    many = f"{abs(number)} half wavelength{'s' * (abs(number) != 1)} too {'many' if number > 0 else 'few'}"
    return f"{_subject_words(claim, 'a counter')} counts {many}{since}"


def _shifted(claim: Claim) -> str:
    since = claim.since("step")
    shifts = [size for size in claim.sizes if size.name.startswith("shift")]
    size = max(shifts, key=lambda shift: abs(shift.number or 0.0) / (shift.sigma or 1.0), default=None)
    run = _parts(claim).get("run", "")
    several = next((word for word in ("displacements", "signals") if word in claim.subject.split()), "")
    if not several:
        size_text = f" by {size_in_words(size)}" if size is not None else ""
        return f"the zero of {_subject_words(claim, 'a channel')} shifts{size_text}{since}"
    most = f", {size.name.removeprefix('shift_')} by {size_in_words(size)}" if size is not None else ""
    return f"the zeros of all {several} shift together in run {run}{since}{most}"


def _look_up_event(claim: Claim) -> str:
    return (
        f"Look up in the laboratory's notes what happened in run {_parts(claim).get('run', '')}; repeat it, with a "
        "return to zero before and after."
    )


def _slow_run_advice(claim: Claim) -> str:
    run, signal = claim.fact("run"), claim.fact("channel")
    return f"Repeat run {run} more slowly, return to zero at its end, and watch the signal of {signal}."


def _crosstalk(claim: Claim) -> str:
    size, more = largest_of_kind(claim, "fraction")
    source = claim.fact("source")
    disturbing = f"signal {source}" if source else "another"
    turned = "" if more else ", with the opposite sign"
    return f"{_subject_words(claim, 'a signal')} contains {size or 'a fraction'} of {disturbing}{turned}"


def _disconnect(claim: Claim) -> str:
    source, signal = claim.fact("source"), claim.fact("signal")
    return f"Disconnect the bridge of {source}, load the sensor, and see how {signal} changes."


def _curved(claim: Claim) -> str:
    """Return ``signal v1 is not linear, with a quadratic part of ...``, for the most significant term."""
    who = _subject_words(claim, "")
    text = f"{who} is not linear" if who else "the signals are not linear"
    size = max(
        claim.sizes,
        key=lambda size_of_term: abs(size_of_term.number or 0.0) / (size_of_term.sigma or 1.0),
        default=None,
    )
    if size is None:
        return text
    term, _, signal = size.name.partition("_v")
    of, to = (f" {word} v{signal}" if signal else "" for word in ("of", "to"))
    if term in ("quadratic", "cubic"):
        return f"{text}, with a {term} part{of} of {size_in_words(size)}"
    return f"{text}: the product {term.replace('_', '·')} contributes {size_in_words(size)}{to} at the largest loads"


def _straighten(claim: Claim) -> str:
    who = _subject_words(claim, "the signals")
    return f"Load in smaller steps up to the largest loads, alone and two at a time, and read {who} at each."


def _rows(claim: Claim) -> str:
    """Return ``steps 12 and 17 of run 2``; of two runs ``step 3 of run 1 and step 4 of run 2``."""
    rows = claim.fact("rows") or ()
    pairs = [row.split("/") for row in rows.split()] if isinstance(rows, str) else rows
    runs = {run for run, _ in pairs}
    if len(runs) == 1:
        return f"steps {listed(step for _, step in pairs)} of run {next(iter(runs))}"
    return " and ".join(f"step {step} of run {run}" for run, step in pairs) or "two rows"


def _exchanged(claim: Claim) -> str:
    if claim.fact("step") == "instrument":
        return f"the signals of {_rows(claim)} are exchanged"
    components = claim.fact("components") or ()
    names = components if isinstance(components, str) else " ".join(components)
    within = f", in {names}" if names else ""
    return f"the recorded loads of {_rows(claim)} are exchanged{within}"


def _look_up_loads_advice(claim: Claim) -> str:
    return f"Look up in the laboratory's notes which loads were applied at {_rows(claim)}, or apply both loads again."


BENCH = {
    "load-eccentricity": Wording("load eccentricity", _eccentric, _shift_load),
    "load-imbalance": Wording("load imbalance", _imbalance, _one_unit),
    "stiffness-scale": Wording(
        "stiffness scale",
        _stiffness,
        "Measure the same deflection with another instrument, along the line of the load.",
    ),
    "stiffness-asymmetry": Wording(
        "stiffness asymmetry",
        _asymmetry,
        "Repeat the run with the sensor reversed, or with preload: an asymmetry of the sensor reverses with it.",
    ),
    "leg-stiffness": Wording("leg stiffness", _soft_leg, _swap_legs),
    "stiffness-nonlinear": Wording(
        "stiffness nonlinear",
        _nonlinear,
        "Load in smaller steps up to the largest load, and above it where that is allowed.",
    ),
    "hysteresis": Wording(
        "hysteresis",
        _hysteresis,
        "Load and unload three times without a pause: a loop of constant width is hysteresis, a shrinking one creep.",
    ),
    "play-hysteresis": Wording(
        "play hysteresis",
        _drag,
        "Load and unload with increasing largest loads, with a pause at zero: a hysteresis remainder stays constant "
        "and has the sign of the last load.",
    ),
    "signal-hysteresis": Wording(
        "hysteresis of the signals",
        _signals_lag,
        "Load and unload three times, with pauses of different length: hysteresis does not depend on time, creep does.",
    ),
    "joint-clearance": Wording("joint clearance", _play, _through_zero),
    "creep": Wording(
        "creep",
        _creep,
        "Hold the largest load for ten time constants, with ten readings each, then unload and continue reading.",
    ),
    "zero-drift": Wording("zero drift", _zero_drift_clause, _unloaded),
    "thermal-drift": Wording("thermal drift", _warm, _zero_against_temperature),
    "cosine-error": Wording("cosine error", _tilted, _align),
    "abbe-offset": Wording("abbe offset", _arm, _shift_beam),
    "dead-path": Wording(
        "dead path",
        _dead_path,
        "Measure the path from beam splitter to mirror; read it without load while the air pressure changes.",
    ),
    "fringe-slip": Wording("fringe slip", _slip, _slow_run_advice),
    "zero-step": Wording("zero step", _shifted, _look_up_event),
    "crosstalk": Wording("crosstalk", _crosstalk, _disconnect),
    "signal-nonlinear": Wording("signal nonlinear", _curved, _straighten),
    "rows-exchanged": Wording("rows exchanged", _exchanged, _look_up_loads_advice),
}
