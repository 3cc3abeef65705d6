"""Export of the extended model for a machine's controller: its numbers as TOML and CSV, each with its sigma."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from scipy.special import ndtri

from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.runs.exports.axis_corrections import axis_corrections
from truing.runs.exports.csv_text import csv_bytes
from truing.runs.recorded_run import Run
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.settings_text import Document
from truing.simulation.axis.extended_model import ExtendedAxis
from truing.simulation.model_text import toml_key, toml_value

if TYPE_CHECKING:
    import pandas as pd

_Number = tuple[str, str, float, float | None, str]  # of what, its name, value, sigma, unit
_UNLIKELY = 0.05  # familywise p-value of the pulls of all parameters
IMPLAUSIBLE_PULL = 3.0  # pull of a chain's number from which its tolerance does not explain it
_CAUTIONS = {
    "not-determined": "the measurements do not determine it: it stays near nominal, or is correlated with others",
    "far-from-nominal": "it is farther from nominal than its tolerance explains: it absorbs what the model lacks",
    "suspected": "its cause is only suspected",
    "inadequate": "the model does not hold as a whole: something acts that none of its numbers describes",
}
_LENGTHS, _XYZ = ("a_mm", "b_mm"), "xyz"
_OF_MECHANISM = ("reference_temperature_c", "kind", "loop")


def controller(run: Run) -> Iterator[tuple[str, bytes]]:
    """Yield ``controller.toml`` and ``controller.csv``: legs, joints or compliance, effects, a sensor's matrix G_B.

    An axis also gives ``axis_corrections.csv``, a linear calibration ``wrench_matrix.csv`` for a data logger. Without
    an extended model there are no numbers of the machine.
    """
    yield from _logger(run)
    path = run.folder / ARTIFACTS["model"].file
    warned = reasons_for_caution(run)
    document = tomllib.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    if "model" not in document:
        return
    matrix, joints = _matrix(run), list(_joint_numbers(run))
    lines = [*_text(document), *_joint_text(joints), *_matrix_text(matrix), *_caution_text(warned), ""]
    yield "controller.toml", "\n".join(lines).encode()
    numbers = [*_leg_numbers(document), *joints, *_compliance(document), *_effects(document), *matrix]
    yield "controller.csv", _csv(numbers, warned)
    if isinstance(model := run.model, ExtendedAxis):
        yield from axis_corrections(model, run, next(iter(warned.values()), ""))


def reasons_for_caution(run: Mapping[str, pd.DataFrame]) -> dict[tuple[str, str], str]:
    """Return the reason code of numbers that are no physical properties of the machine, by subject and name.

    They reproduce poses together with all others, but mislead if used alone, for example as masses and stiffnesses of a
    dynamic controller. A name of "" concerns all numbers of an effect, or of the model.
    """
    reasons: dict[tuple[str, str], str] = {}
    if "pulls" in run:
        pulls = run["pulls"].dropna(subset=["leg"])
        limit = -float(ndtri(_UNLIKELY / 2 / max(len(pulls), 1)))
        for row in pulls.itertuples():
            of = f"leg{int(row.leg)}", "length" if row.parameter == "l" else str(row.parameter)
            if not row.identifiable:
                reasons[of] = "not-determined"
            elif abs(row.pull_after) > limit:
                reasons[of] = "far-from-nominal"
    if "chain_parameters" in run:
        for row in run["chain_parameters"].itertuples():
            if not row.identifiable:
                reasons[f"joint {row.joint}", row.parameter] = "not-determined"
            elif abs(row.pull) > IMPLAUSIBLE_PULL:
                reasons[f"joint {row.joint}", row.parameter] = "far-from-nominal"
    if "diagnosis" in run:
        rows = run["diagnosis"]
        for row in rows[rows["verdict"] == "suspected"].itertuples():
            reasons[f"{row.cause} {row.subject or ''}".strip(), ""] = "suspected"
    if "adequacy" in run and (run["adequacy"]["state"] == "fails").any():
        reasons["model", ""] = "inadequate"
    return reasons


def _caution_text(warned: dict[tuple[str, str], str]) -> Iterator[str]:
    if warned:
        yield "\n# Use these numbers only together with all others, for poses: not as physics, not in dynamic control."
    for (of, name), code in warned.items():
        yield from ("", "[[caution]]", f"of = {toml_value(of)}")
        yield from (f"name = {toml_value(name)}",) if name else ()
        yield from (f"reason_code = {toml_value(code)}", f"reason = {toml_value(_CAUTIONS[code])}")


def _logger(run: Run) -> Iterator[tuple[str, bytes]]:
    """Yield matrix and offset of load = G_B . signals + offset, a row for each load, if the calibration is linear."""
    sensor = run.sensor
    if sensor is None or (offset := sensor.offset) is None:
        return
    rows = [["load", "unit", *(f"per_{name}_mv" for name in sensor.signal_names), "offset"]]
    for name, entries, zero in zip(sensor.load_names, sensor.matrix.value, offset, strict=True):
        rows.append([name, "N" if name[0] == "f" else "N m", *(repr(float(entry)) for entry in (*entries, zero))])
    yield "wrench_matrix.csv", csv_bytes(rows)


def _text(document: Document) -> Iterator[str]:
    """Yield the mechanism in the format of campaign.toml with the identified numbers, and the effects."""
    about = document["model"]
    is_whole = "legs" in document or "compliance" in document
    simulates = "a [mechanism] that simulates this machine" if is_whole else "what its model holds"
    yield f"# {about.get('campaign', '')}: identified by truing; {simulates}"
    yield "[mechanism]"
    yield f"type = {toml_value(about['mechanism'])}"
    yield from (f"{key} = {toml_value(about[key])}" for key in _OF_MECHANISM if key in about)
    if "legs" in document:
        yield from ("legs = [", *(f"  {toml_value(leg['identified'])}," for leg in document["legs"]), "]")
    if "compliance" in document:
        rows = (f"  {toml_value(row)}," for row in document["compliance"]["identified"])
        yield from (
            "",
            "[compliance]  # SI, rows dx dy dz rx ry rz, columns fx fy fz mx my mz",
            "identified = [",
            *rows,
            "]",
        )
    for effect in document.get("effects", ()):
        yield from (
            "",
            "[[effects]]",
            f"cause = {toml_value(effect['cause'])}",
            f"subject = {toml_value(effect['subject'])}",
        )
        yield "[effects.parameters]"
        yield from (f"{toml_key(name)} = {toml_value(reported)}" for name, reported in effect["parameters"].items())


def _leg_numbers(document: Document) -> Iterator[_Number]:
    for number, leg in enumerate(document.get("legs", ()), start=1):
        identified, sigma, name = leg["identified"], leg.get("sigma", {}), f"leg{number}"
        for point in _LENGTHS:
            for axis, value, spread in zip(_XYZ, identified[point], sigma.get(point, [None] * 3), strict=True):
                yield name, f"{point.removesuffix('_mm')}_{axis}", value, spread, "mm"
        for axis, value in zip(_XYZ, identified.get("u", ()), strict=False):
            yield name, f"u_{axis}", value, None, "1"
        for length in ("length_mm", "rho0_mm"):
            yield name, length.removesuffix("_mm"), identified[length], sigma.get(length), "mm"


def _joint_numbers(run: Run) -> Iterator[_Number]:
    for row in run["chain_parameters"].itertuples() if "chain_parameters" in run else ():
        yield f"joint {row.joint}", row.parameter, row.identified, row.sigma, row.unit


def _joint_text(numbers: list[_Number]) -> Iterator[str]:
    """Yield a table per joint of a chain: the identified change of its nominal frame in the link below."""
    for joint in dict.fromkeys(of for of, *_ in numbers):
        yield from ("", f"[{json.dumps(joint, ensure_ascii=False)}]  # changes of the nominal frame, along its axes")
        for of, name, value, sigma, unit in numbers:
            if of == joint:
                yield f"{name} = {toml_value({'value': value, 'sigma': sigma, 'unit': unit})}"


def _compliance(document: Document) -> Iterator[_Number]:
    reported = document.get("compliance")
    if reported is None:
        return
    for channel, values, sigmas in zip(CHANNELS, reported["identified"], reported["sigma"], strict=True):
        for load, value, sigma in zip(LOADS, values, sigmas, strict=True):
            unit = f"{'m' if channel[0] == 'd' else 'rad'}/{'N' if load[0] == 'f' else '(N m)'}"
            yield "compliance", f"{channel} {load}", value, sigma, unit


def _effects(document: Document) -> Iterator[_Number]:
    for effect in document.get("effects", ()):
        of = f"{effect['cause']} {effect['subject']}".strip()
        for name, reported in effect["parameters"].items():
            if not isinstance(reported["value"], str):
                yield of, name, reported["value"], reported.get("sigma"), reported["unit"]


def _matrix(run: Run) -> list[_Number]:
    if "sensor_matrix" not in run:
        return []
    table = run["sensor_matrix"]
    rows = table[table["chosen"] & (table["matrix"] == "G_B")]
    names = rows["row"] + " " + rows["column_name"]
    return list(zip(rows["matrix"], names, rows["value"], rows["sigma"], rows["unit"], strict=True))


def _matrix_text(matrix: list[_Number]) -> Iterator[str]:
    if matrix:
        yield from ("", "[G_B]  # a load is the sum over the signals of number times signal")
    for _, name, value, sigma, unit in matrix:
        yield f"{json.dumps(name)} = {toml_value({'value': value, 'sigma': sigma, 'unit': unit})}"


def _csv(numbers: list[_Number], warned: dict[tuple[str, str], str]) -> bytes:
    rows = [["of", "name", "value", "sigma", "unit", "caution"]]
    for of, name, value, sigma, unit in numbers:
        caution = warned.get((of, name)) or warned.get((of, "")) or ""
        rows.append([of, name, repr(float(value)), "" if sigma is None else repr(float(sigma)), unit, caution])
    return csv_bytes(rows)
