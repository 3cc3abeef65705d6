"""Wordings of nonparametric effects, and names of columns in sentences."""

from __future__ import annotations

import re
from collections.abc import Iterable

from truing.report.diagnosis.findings import subject_words
from truing.report.numbers import joined_names, p_at_most, percent
from truing.report.wordings.claim import SURE, Claim, Wording, largest_change_words
from truing.schemas.covariates import own_name

_PARTS = r"joint |leg\d"  # subjects whose errors move the observations in a direction of their own
_DRIVE, _LOAD = r"rho(\d+)_mm", r"([fm][xyz])_nm?"
_WEIGHT = r"(torque|force)_(.+)_nm?"  # of weight on a joint
_APPROACH = r"approach_(.+)"  # of a joint
_COLUMNS = {
    "temperature_c": "the temperature",
    "time_s": "time",
    "order": "the order of measurement",
    "time_in_run_s": "the time in the run",
    "air_temperature_c": "the temperature of the air",
    "material_temperature_c": "the temperature of the material",
    "air_pressure_hpa": "the pressure of the air",
    "relative_humidity_pct": "the humidity",
    "own drive": "the displacement of each leg's own actuator",
    "approach": "the direction from which each actuator came",
    "last step": "the last movement of each actuator",
    "memory": "the recent movements of each actuator",
    "relaxing 1": "the recent movements of each leg's own actuator",
    "stop 1": "the displacement of each leg's own actuator",
    "command": "the command",
    "direction of approach": "the direction of approach",
    "travel since the turn": "the travel of the axis since it reversed",
}
# Inputs with a value for each actuator, where a single leg depends on them.
_COLUMNS_OF_ONE_LEG = {
    "own drive": "the displacement of its own actuator",
    "approach": "the direction from which its actuator came",
    "last step": "the last movement of its actuator",
    "memory": "the recent movements of its actuator",
}
OF_TIME = {"time_s", "order", "time_in_run_s"}
# Setting of a nonparametric effect: inputs on which its subject may depend instead, about as probably.
INSTEAD = "instead"
QUANTITIES_INSTEAD = "quantities_instead"
_OF_AXIS = {"command", "direction of approach"}
PARTS_OF_AXES = {
    "axis": "the transmission of the axis (or an encoder that these readings cannot distinguish from it)",
    "encoder load": "the encoder at the load",
    "encoder motor": "the encoder at the motor",
    "instrument": "the outside instrument",
}
# Functions of a load, by the prefix of its name.
_OF_LOAD = {
    "unloading ": "whether {} falls",
    "direction of ": "the direction in which {} changes",
    "largest so far ": "the largest size of {} so far in a run",
}
_WHOSE = {
    "readings": "the effective readings of {}",
    "lengths": "the effective lengths of {}",
    "attachments": "the attachments of {} along the platform's z",
    "attachments sideways": "the attachments of {} across the platform's z",
}


def _of_joint(column: str) -> str:
    """Return the load of weight on a joint, or its direction of approach, in words, and any other column as it is."""
    if came := re.fullmatch(_APPROACH, column):
        return f"the direction of approach of {came[1]}"
    match = re.fullmatch(_WEIGHT, column)
    return f"the {match[1]} of weight on {match[2]}" if match else column


def columns_words(columns: tuple[str, ...]) -> str:
    """Return columns in words: ``actuator 2 and the temperature``, ``load fz``."""
    drives = [match[1] for c in columns if (match := re.fullmatch(_DRIVE, c))]
    loads = [f"load {match[1]}" if (match := re.fullmatch(_LOAD, c)) else _of_joint(c) for c in columns]
    other_loads = [_COLUMNS.get(c, own_name(c)) for c in loads if not re.fullmatch(_DRIVE, c)]
    if len(drives) > 2:
        return joined_names(["the actuators", *other_loads])
    texts = [f"actuator{'s' * (len(drives) > 1)} {' and '.join(drives)}"] if drives else []
    return joined_names([*texts, *other_loads])


def remainder_clause(
    columns: tuple[str, ...], subject: str, share: float, *, remains: bool = True, is_partial: bool = False
) -> str:
    """Return the clause on residuals and the inputs that predict them, without a full stop.

    They are those of the model without causes or of the final one; the share is of the former's variance. ``remains``:
    False if the other findings explain the same. ``is_partial``: True if there are other findings, which may explain a
    part.
    """
    place = "in the direction of" if re.match(_PARTS, subject) else "of"
    subject_text = f" {place} {subject_words(subject)}" if subject else ""
    most = f"{'' if subject else 'up to '}{percent(100.0 * share)}"
    whose = "The residuals" if remains else "Without the other findings, the residuals"
    text = f"{whose}{subject_text} depend on {columns_words(columns)}"
    text = f"{text}; this explains {most} of the residual variance of the model without causes"
    return f"{text}, and the other findings explain at most a part of that" if remains and is_partial else text


def remainder_advice(columns: tuple[str, ...]) -> str:
    """Return the advice where residuals depend on columns: measure the same with these changed."""
    not_of_time = tuple(column for column in columns if column not in OF_TIME)
    if not not_of_time:
        return "Repeat a part of the campaign in another order, to see whether the error depends on time."
    return f"Repeat a part of the campaign with {columns_words(not_of_time)} changed and everything else unchanged."


def remainder_explanation(
    clause: str, p_value: float, *, is_of_all: bool, remains: bool, is_partial: bool = False
) -> str:
    """Return the explanation of inputs that predict the residuals where no model of causes holds.

    ``is_of_all``: of all channels together; ``remains`` and ``is_partial`` as in the ``clause``.
    """
    largest_text = " (for the actuator or body with the largest share)" if is_of_all else ""
    rest = (
        "With the other findings in the model, it is still significant: the extended model does not hold all of it."
        if remains and is_partial
        else "The extended model does not hold this dependence, and no cause is named for it."
        if remains
        else "With the other findings in the model, it is no longer significant. Either may be the cause."
    )
    return (
        f"{clause}{largest_text}, by smooth functions of this input or its history. "
        f"Probability by chance: {p_at_most(p_value)}, corrected for all inputs. {rest}"
    )


def _column_words(column: str) -> str:
    """Return one column in words: ``the displacement of actuator 3``, ``the load fz``, ``the temperature``."""
    for start, words in _OF_LOAD.items():
        if column not in _COLUMNS and column.startswith(start):
            return words.format(_column_words(column.removeprefix(start)))
    if drive := re.fullmatch(_DRIVE, column):
        return f"the displacement of actuator {drive[1]}"
    if load := re.fullmatch(_LOAD, column):
        return f"the load {load[1]}"
    return _COLUMNS.get(column) or own_name(_of_joint(column))


def product_words(names: Iterable[str]) -> str:
    """Return ``time``, ``the square of time``, ``the product of time and the temperature``."""
    first, *more = names
    if not more:
        return first
    return f"the square of {first}" if first == more[0] else f"the product of {first} and {more[0]}"


def _inputs_in_words(claim: Claim) -> str:
    """Return the inputs and the form of a dependence; only the table's columns where that has no settings."""
    columns = claim.fact("columns")
    if not columns:
        return columns_words(claim.follows) or "none of the recorded columns"
    rows = "steps" if claim.fact("channel") else "rows" if claim.fact("element") else ""
    own_words = {"order": f"the order of the {rows}"} if rows else {}
    own_words |= _COLUMNS_OF_ONE_LEG if len(claim.fact("legs") or ()) == 1 else {}
    texts = [own_words.get(column) or _column_words(column) for column in columns]
    first, half = texts[0], claim.fact("half_ranges")[0]
    size = f"{half:.4g} {_LOADS.get(columns[0], 's')}"
    is_timed = columns[0] != "order"  # without times, no duration is known
    forms = {
        "all drives": "the displacements of all actuators",
        "period": f"{first}, periodically with a period of {size}",
        "beyond": f"{first}, with a jump beyond {size}",
        "rest": f"{first} since the last long pause of a run, decaying within about {half:.0f} s",
        "loop": f"{first} and {texts[-1]}",
        "stretch": f"{first}, constant over {f'{2.0 * half:.4g} s' if is_timed else 'a part of them'}",
        "surface": f"{first} and {texts[-1]}",
        "history": f"{first} and on how it was reached",
        "relaxation": f"{first}, with relaxation after them",
        "gain": f"{first}, with a factor that depends on {texts[-1]}",
    }
    if claim.fact("form") == "memory":
        return f"{first} of steps before"
    return forms.get(claim.fact("form")) or product_words(texts)


_LOADS = dict.fromkeys(("fx_n", "fy_n", "fz_n"), "N") | dict.fromkeys(("mx_nm", "my_nm", "mz_nm"), "N m")


def _clause(claim: Claim) -> str:
    verb = "depends" if _has_one_subject(claim) else "depend"
    is_higher_order = (claim.fact("first") or 1) > 1  # terms of an effect that has a row of its own
    form = " quadratically" if _is_quadratic(claim) and not is_higher_order else ""
    alternatives = [columns_words(tuple(columns)) for columns in claim.fact(INSTEAD) or ()]
    inputs = f"{_inputs_in_words(claim)}{''.join(f', or instead on {alternative}' for alternative in alternatives)}"
    terms = ", also in terms of higher order" if is_higher_order else ""
    return f"{_dependent_quantity(claim)} {verb}{form} on {inputs}{terms}{largest_change_words(claim)}"


def _is_quadratic(claim: Claim) -> bool:
    """Return True if the polynomial of one input has no sure term but that of second degree."""
    sizes = [size for size in claim.sizes if re.fullmatch(r"degree\d+", size.name) and size.number is not None]
    sure = [size.name for size in sizes if size.sigma is not None and abs(size.number or 0.0) > SURE * size.sigma]
    return len(claim.fact("columns") or ()) == 1 and sure == ["degree2"]


def _has_one_subject(claim: Claim) -> bool:
    return claim.fact("quantity") in (None, "scale") or len(claim.fact("targets") or ()) == 1


def _dependent_quantity(claim: Claim) -> str:
    """Return the dependent quantity: of legs, targets of a body, a channel, a camera, a part of an axis."""
    if claim.fact("element"):
        return PARTS_OF_AXES.get(claim.subject, claim.subject)
    if (joint := claim.fact("joint")) is not None:
        link = claim.fact("link")
        if claim.fact("length_of"):
            also = " or ".join(subject_words(link) for link in claim.fact("alike") or ())
            return f"the length of link {claim.fact('length_of')}{f' or {also}' if also else ''}"
        return (
            f"the motion of joint {joint}"
            if joint
            else f"the place of link {link}"
            if link
            else "the place of the base"
        )
    quantity, targets = claim.fact("quantity"), list(claim.fact("targets") or ())
    if quantity == "scale":
        return "the scale of the measurement"
    if quantity == "targets":
        targets_text = f"target {targets[0]}" if len(targets) == 1 else "the targets"
        return f"{targets_text} on {claim.fact('body')}"
    if quantity in _WHOSE:
        subject = subject_words(claim.subject) or "the legs"
        others = [_WHOSE[other].format(subject) for other in claim.fact(QUANTITIES_INSTEAD) or () if other in _WHOSE]
        return _WHOSE[quantity].format(subject) + "".join(f", or instead {other}," for other in others)
    number = f"{claim.fact('name')} of " if claim.fact("name") else ""
    return number + subject_words(claim.subject) if claim.subject else "something"


def _advice(claim: Claim) -> str:
    plural, singular = "poses", "pose"
    if claim.fact("channel"):
        plural, singular = "load steps", "load"
    if claim.fact("element"):
        plural, singular = "commands", "command"
    if claim.fact("element") and set(claim.fact("columns") or ()) <= _OF_AXIS:
        return "Approach more commands, also between the present ones, five times from either side."
    if all(re.fullmatch(_WEIGHT, column) for column in claim.fact("columns") or ("",)):
        return "Repeat the same poses with another payload, everything else unchanged."
    if any(re.fullmatch(_APPROACH, column) for column in claim.fact("columns") or ()):
        return (
            f"Approach the same poses from both sides, at several values of {_column_words(claim.fact('columns')[0])}."
        )
    if set(claim.fact("columns") or ()) <= OF_TIME:
        return f"Repeat some {plural} in another order, to see whether the effect depends on time or on the {singular}."
    return f"Repeat some {plural} with another value of {_inputs_in_words(claim)}, everything else unchanged."


FOLLOWED = {"unexplained": Wording("nonparametric effect", _clause, _advice)}
