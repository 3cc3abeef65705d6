"""The rows of cause_uncertainty.parquet: where the uncertainty of every number that was found comes from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.inference.linear_problem import EARLIER, INPUTS, OBSERVATIONS, PLAUSIBLE, WIDE
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.fitted_model import FittedModel
    from truing.inference.linear_problem import Contribution
    from truing.inference.selection import Diagnosis
    from truing.simulation.cause import Cause

# Sources in words, by how a model calls its kinds of unknowns.
_WORDS = {
    EARLIER: "what the earlier campaign found",
    PLAUSIBLE: "sizes of causes held to be plausible",
    WIDE: "numbers of which nothing is declared",
    "a": "tolerance of the lower joints",
    "b": "tolerance of the upper joints",
    "u": "tolerance of the directions of the actuators",
    "l": "tolerance of the lengths of the legs",
    "shape": "survey of the targets",
    "zero": "zeros of the runs, as declared",
    "geometry": "tolerance of the sensor's lengths",
    "stiffness": "tolerance of the sensor's stiffness",
    "gain": "gains of the signals, as declared",
    "legforce": "models of what a leg carries",
    "optics": "beams and material, as declared",
    "photographs": "cameras and scale bars, common to all poses",
    "common": "lengths of scale bars, as calibrated",
}
_READ = {
    "points": "readings of the actuators",
    "bodies": "standing of what should stand still",
    "channel": "applied loads",
    "encoder": "standing of the axis at its command",
}
# What was measured, by what a model calls one channel.
_MEASURED = {
    "target": "measured points",
    "channel": "readings and signals",
    "encoder": "readings of the encoders",
    "rays of": "rays of photographs",
}
# Noise is of its declared size unless what was measured shows it to be larger by this much.
_LARGER = 1.01


def uncertainty_table(diagnosis: Diagnosis, legs: int) -> pa.Table:
    """Rows of every number with a sigma of every cause that was found and named, by source."""
    rows, final = Rows("cause_uncertainty"), diagnosis.final
    for verdict in diagnosis.verdicts:
        if verdict.verdict == "found" and verdict.cause.key in final.model.layout:
            for given in final.contributions(verdict.cause):
                _add(rows, final, verdict.cause, given, legs)
    return rows.table()


def _add(rows: Rows, final: FittedModel, cause: Cause, given: Contribution, legs: int) -> None:
    name, larger = _source(final, given)
    with np.errstate(all="ignore"):  # a part may give nothing to a number that is a length or an angle
        told = cause.reported(final.values(cause)[0], given.covariance, legs)
    for one in told:
        if one.sigma is not None and np.isfinite(one.sigma):
            rows.add(
                cause=cause.id,
                subject=cause.subject,
                parameter=one.name,
                input_source=name,
                evaluation="A" if larger else "B",
                contribution=float(one.sigma),
                degrees_of_freedom=max(given.freedom, 1.0) if larger else None,
                unit=one.unit,
            )


def _source(final: FittedModel, given: Contribution) -> tuple[str, bool]:
    """A source in words, and whether its size was found from what was measured."""
    readings, survey = final.learned
    if given.source == OBSERVATIONS:
        return f"{_MEASURED[final.model.channel_word]}, at the noise found", True
    if given.source == INPUTS:
        word = final.model.channel_word
        kind = word if not final.fit.frames.size else "points" if final.model.part_count else "bodies"
        return _found(_READ[kind], readings)
    if given.source == "shape":
        return _found(_WORDS["shape"], survey)
    return _WORDS[given.source], False


def _found(words: str, ratio: float) -> tuple[str, bool]:
    return (f"{words}, at the noise found", True) if ratio > _LARGER else (f"{words}, as declared", False)
