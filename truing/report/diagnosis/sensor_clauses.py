"""What is wrong on a force sensor's bench, in one clause each: load, sensor, beam, counter, signal."""

from __future__ import annotations

import re
from collections.abc import Callable

from truing.report.diagnosis.clause_parts import largest, positive, sure_of, told
from truing.report.diagnosis.judged import Judged, Size

_ALONG = {"fx": "x", "fy": "y", "fz": "z", "mx": "x", "my": "y", "mz": "z"}


def _axis(row: Judged) -> str:
    """``fz`` of ``load fz``; empty for all axes."""
    found = re.search(r"\bload (\w+)", row.subject)
    return found[1] if found else ""


def load_words(axis: str, article: str = "the ", plural: bool = False) -> str:
    """``the z load``, ``torques about x``; a word of the lab's own as it is; ``loads`` of all axes."""
    ending = "s" if plural else ""
    if axis not in _ALONG:
        return f"{article}load{ending} {axis}".rstrip()
    return (
        f"{article}{_ALONG[axis]} load{ending}" if axis[0] == "f" else f"{article}torque{ending} about {_ALONG[axis]}"
    )


def _loads(row: Judged) -> str:
    """``z loads``; ``load`` of all axes."""
    return load_words(_axis(row), "", plural=True) if _axis(row) else "load"


def _where(row: Judged, otherwise: str) -> str:
    """The channel, signal or run that a cause concerns: ``channel dz``, ``channel dz in run 4``."""
    parts = dict(re.findall(r"\b(run|channel|signal) (\S+)", row.subject))
    name = next((f"{kind} {parts[kind]}" for kind in ("channel", "signal") if kind in parts), "")
    if "run" not in parts:
        return name or otherwise
    return f"{name} in run {parts['run']}" if name else f"run {parts['run']}"


def _towards(sizes: tuple[Size, ...]) -> str:
    """``12.0 ± 0.1 mm towards +x and 8.0 ± 0.1 mm towards -y``: components that are sure, else the largest."""
    return " and ".join(f"{told(positive(size))} towards {_direction(size)}" for size in sure_of(sizes))


def _direction(size: Size) -> str:
    return f"{'−' if (size.number or 0.0) < 0.0 else '+'}{size.name.partition('_')[2][:1]}"


def _eccentric(row: Judged) -> str:
    axis = _axis(row)
    if axis.startswith("m"):
        return f"{load_words(axis)} brings a force along: {_towards(row.sizes)}"
    who, verb = (load_words(axis), "acts") if axis else ("the forces", "act")
    aside = _towards(row.sizes)
    one = re.fullmatch(r"(\S+ ± \S+ mm|\S+ mm) (towards \S+)", aside)
    return f"{who} {verb} {one[1]} beside the origin, {one[2]}" if one else f"{who} {verb} beside the origin: {aside}"


def _imbalance(row: Judged) -> str:
    """What differs between the directions, or grows with the load, first; what is in proportion is an eccentricity."""
    differs = [size for size in row.sizes if size.name.endswith(("_asymmetry", "_growth")) and size.number is not None]
    shown = largest(tuple(differs or row.sizes))
    who = load_words(_axis(row))
    if shown is None:
        return f"the units that drive {who} are out of balance"
    what, component = shown.name.split("_")[:2]
    brought = f"a parasitic {what} {'about' if what == 'moment' else 'along'} {component}"
    size = told(positive(shown))
    if shown.name.endswith("_growth"):
        return f"{who} brings {brought} that grows out of proportion, by {size} at the largest load"
    if shown.name.endswith("_asymmetry"):
        return f"{who} brings {brought} that differs by {size} between positive and negative load"
    return f"{who} brings {brought}: {size}"


def _only(row: Judged, name: str) -> tuple[str, bool]:
    """The size of the one parameter without its sign, and whether that is positive."""
    size = largest(row.sizes_of(name))
    return ("", True) if size is None else (told(positive(size)), (size.number or 0.0) > 0.0)


def _stiffness(row: Judged) -> str:
    size, more = _only(row, "scale")
    return f"the sensor is {size} {'stiffer' if more else 'softer'} under {_loads(row)} than simulated"


def _asymmetry(row: Judged) -> str:
    size, more = _only(row, "asymmetry")
    one, other = ("positive", "negative") if more else ("negative", "positive")
    return f"the sensor gives {size} more under {one} {load_words(_axis(row), '', plural=True)} than under {other} ones"


def _nonlinear(row: Judged) -> str:
    size, more = _only(row, "cubic")
    way = "more" if more else "less"
    return f"the sensor is not linear under {_loads(row)}: at the largest it gives {size} {way} than in proportion"


def _hysteresis(row: Judged) -> str:
    size, more = _only(row, "width")
    way = "stays behind" if more else "runs ahead"
    return f"the deflection under {_loads(row)} {way} on unloading, by {size} of the largest at half load"


def _play(row: Judged) -> str:
    size, _ = _only(row, "clearance")
    jumps = f"jumps by {size}" if size else "jumps"
    return f"the joints have play: the platform {jumps} as {load_words(_axis(row))} changes its sign"


def _creep(row: Judged) -> str:
    size, more = _only(row, "fraction")
    tau = row.size("tau")
    pace = f", with a time constant of {told(tau)}" if tau is not None else ""
    way = "creeps on" if more else "creeps back"
    return f"the sensor {way} under {_loads(row)}, by {size} of its deflection{pace}"


def _walk(row: Judged) -> str:
    size, up = _only(row, "rate")
    return f"the zero of {_where(row, 'the channels')} walks {'up' if up else 'down'}, by {size}"


def _warm(row: Judged) -> str:
    of = {"per_k_material": "the material", "per_k_air": "the air"}
    each = [f"the temperature of {of[s.name]} by {told(s)}" for s in row.sizes if s.name in of]
    return f"{_where(row, 'every linear channel')} follows {' and '.join(each) or 'the temperature'}"


def _tilted(row: Judged) -> str:
    size, _ = _only(row, "angle")
    return f"the beam of {_where(row, 'a channel')} stands{f' {size}' if size else ''} off its axis"


def _arm(row: Judged) -> str:
    return f"the beam of {_where(row, 'a channel')} misses the origin: {_towards(row.sizes)}, so rotation leaks into it"


def _dead_path(row: Judged) -> str:
    size = row.size("dead_path")
    long = f" of {told(size)}" if size is not None else ""
    return f"{_where(row, 'every linear channel')} carries a dead path{long} that is not compensated for the air"


def _slip(row: Judged) -> str:
    count, onset = row.size("count"), row.size("from_step")
    number = int(count.number) if count is not None and count.number is not None else 0
    many = f"{abs(number)} half wavelength{'s' * (abs(number) != 1)} too {'many' if number > 0 else 'few'}"
    since = f" from step {onset.value} on" if onset is not None else ""
    return f"{_where(row, 'a counter')} counts {many}{since}"


def _crosstalk(row: Judged) -> str:
    size, more = _only(row, "fraction")
    source = row.size("source")
    other = f"signal {source.value}" if source is not None else "another"
    return f"{_where(row, 'a signal')} carries {size} of {other}{'' if more else ', with its sign turned'}"


def _exchanged(row: Judged) -> str:
    """Which steps, in the words of the explanation: runs and steps as they are numbered, without its parameters."""
    return row.explanation.partition(": ")[0].removeprefix("The data show that ").rstrip(".") or row.name


SENSOR_CLAUSES: dict[str, Callable[[Judged], str]] = {
    "load-eccentricity": _eccentric,
    "load-imbalance": _imbalance,
    "stiffness-scale": _stiffness,
    "stiffness-asymmetry": _asymmetry,
    "stiffness-nonlinear": _nonlinear,
    "hysteresis": _hysteresis,
    "joint-clearance": _play,
    "creep": _creep,
    "zero-drift": _walk,
    "thermal-drift": _warm,
    "cosine-error": _tilted,
    "abbe-offset": _arm,
    "dead-path": _dead_path,
    "fringe-slip": _slip,
    "crosstalk": _crosstalk,
    "rows-exchanged": _exchanged,
}
