"""Tables on causes: detectable sizes, and contributions of sources to the uncertainty."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import TableRow
from truing.inference.detectable import POWER, EffectSensitivity, effect_sensitivities, sensitivity_to
from truing.inference.determined import determined_combinations
from truing.inference.variance_sources import INPUTS, OBSERVATIONS, PLAUSIBLE, PRIOR_CAMPAIGN, WIDE
from truing.report.diagnosis.findings import combination_words
from truing.report.diagnosis.findings import detectable_words as in_words
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.detection_trials import reported_size
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.inference.search import Search
    from truing.inference.search_end import EndOfSearch
    from truing.inference.selection import CauseDiagnosis, Settings
    from truing.inference.variance_sources import Contribution
    from truing.simulation.cause import Cause

# Sources in words, by a model's name for the kind of unknowns.
_WORDS = {
    PRIOR_CAMPAIGN: "parameters of the prior campaign",
    PLAUSIBLE: "plausible sizes of causes (prior)",
    WIDE: "parameters about which nothing is declared",
    "a": "tolerance of the lower joints",
    "b": "tolerance of the upper joints",
    "u": "tolerance of the directions of the actuators",
    "l": "tolerance of the lengths of the legs",
    "shape": "survey of the targets",
    "links": "tolerance of the links",
    "zeros": "tolerance of the joint zeros",
    "base": "place of the base, about which nothing is declared",
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
    "points": "readings of the actuators or joints",
    "bodies": "positions of bodies declared stationary",
    "channel": "applied loads",
    "encoder": "position of the axis at its command",
    "distance": "readings of the joints",
}
# Measured quantity, by a model's name for one channel.
_MEASURED = {
    "distance": "distances",
    "target": "measured points",
    "channel": "readings and signals",
    "encoder": "readings of the encoders",
    "rays of": "rays of photographs",
}
# Noise counts as declared unless measurements show it larger by this factor.
_LARGER = 1.01


def detectable_table(search: Search, level: float, legs: int) -> pa.Table:
    """Rows per cause, subject and parameter; ``search``: the last one, which accepted no further cause."""
    rows: dict[tuple[object, ...], TableRow] = {}
    for effect_sensitivity in sorted(effect_sensitivities(search, level), key=lambda s: len(s.cause.parameters(legs))):
        row = _row(effect_sensitivity, legs)
        rows.setdefault((row["cause"], row["subject"], row["parameter"], row["unit"]), row)
    return pa.Table.from_pylist(_ordered(rows.values()), schema=ARTIFACTS["detectable"].arrow_schema())


def detectable_words(search: Search, level: float, causes: Iterable[Cause], legs: int) -> dict[str, str]:
    """Detectable size in words by a cause's key; without causes that have no single size."""
    words = {}
    for cause in causes:
        sensitivity = sensitivity_to(search, cause, level)
        if sensitivity is not None and cause.catalogued and (smallest := sensitivity.smallest()) is not None:
            size = reported_size(cause, smallest, legs)
            words[cause.key] = in_words(size.parameter, size.value, size.unit)
    return words


def _row(sensitivity: EffectSensitivity, legs: int) -> dict[str, object]:
    smallest = sensitivity.smallest()
    size = reported_size(cast("Cause", sensitivity.cause), 1.0 if smallest is None else smallest, legs)
    return {
        "cause": sensitivity.kind,
        "subject": sensitivity.cause.subject,
        "parameter": size.parameter,
        "size": None if smallest is None else size.value,
        "unit": size.unit,
        "power": POWER,
    }


def _ordered(rows: Iterable[TableRow]) -> list[TableRow]:
    """Rows in the order of their causes; for each cause, the row without a subject (the whole machine) comes first."""
    ordered_rows = list(rows)
    causes = list(dict.fromkeys(row["cause"] for row in ordered_rows))
    return sorted(ordered_rows, key=lambda row: (causes.index(row["cause"]), bool(row["subject"])))


def adequacy_table(diagnosis: CauseDiagnosis, rule: Settings, subject: str) -> pa.Table:
    """Rows of every test of the final model, of untested properties, and of the end of the search; ``subject``:
    measured quantity."""
    rows, adequacy, level = Rows("adequacy"), diagnosis.adequacy, rule.doubted_level
    rows.add(**_end_row(diagnosis.end, rule.level), subject=subject)
    for test in adequacy.tests:
        p_value = adequacy.corrected(test)
        rows.add(
            subject=subject,
            test=str(test.lack),
            along=test.along,
            value=test.value,
            p_value=p_value,
            limit=level,
            state="ok" if p_value > level else "fails",
        )
    for lack in adequacy.untested:
        rows.add(
            subject=subject,
            test=str(lack),
            along="",
            value=None,
            p_value=None,
            limit=level,
            state="not tested",
            why_untested=str(adequacy.why_untested(lack)),
        )
    return rows.table()


def _end_row(end: EndOfSearch, level: float) -> dict[str, object]:
    return {
        "test": "causes-left",
        "along": "",
        "value": float(end.accepted),
        "p_value": end.p_value,
        "limit": level,
        "state": "ok" if end.is_complete else "fails",
        "search_end": str(end.end),
        "left_cause": "" if end.left is None else end.left.id,
        "left_subject": "" if end.left is None else end.left.subject,
    }


def uncertainty_table(diagnosis: CauseDiagnosis, legs: int) -> pa.Table:
    """Rows of every parameter with a sigma of every named cause found, by source."""
    rows, final = Rows("cause_uncertainty"), diagnosis.final
    for verdict in diagnosis.verdicts:
        if verdict.verdict == "found" and verdict.cause.key in final.model.layout:
            for given in final.contributions(verdict.cause):
                _add(rows, final, verdict.cause, given, legs)
    return rows.table()


def combinations_table(diagnosis: CauseDiagnosis, legs: int) -> pa.Table:
    """Rows of the determined combinations of every accepted cause whose parameters share a unit."""
    rows = Rows("determined_combinations")
    for verdict in diagnosis.verdicts:
        parameters = verdict.cause.parameters(legs)
        if verdict.verdict in ("found", "suspected") and len({(p.unit, p.si) for p in parameters}) == 1:
            si = parameters[0].si
            for combination in determined_combinations(verdict.values / si, verdict.covariance / si**2):
                named = {p.name: round(float(c), 6) for p, c in zip(parameters, combination.coefficients, strict=True)}
                rows.add(
                    cause=verdict.cause.id,
                    subject=verdict.cause.subject,
                    determined=combination_words(named),
                    coefficients=json.dumps(named),
                    combined_value=combination.value,
                    combined_sigma=combination.sigma,
                    unit=parameters[0].unit,
                )
    return rows.table()


def _add(rows: Rows, final: FittedModel, cause: Cause, given: Contribution, legs: int) -> None:
    source = source_of(final, given)
    with np.errstate(all="ignore"):  # a part may give nothing to a number that is a length or an angle
        reported = cause.reported(final.values(cause)[0], given.covariance, legs)
    for parameter in reported:
        if parameter.sigma is not None and np.isfinite(parameter.sigma):
            rows.add(
                cause=cause.id,
                subject=cause.subject,
                parameter=parameter.name,
                contribution=float(parameter.sigma),
                unit=parameter.unit,
                **source,
            )


def source_of(final: FittedModel, given: Contribution) -> TableRow:
    """Columns of a source: its name, its evaluation (A if its size was estimated from measurements), and the degrees
    of freedom of that estimate."""
    words, estimated = _named_source(final, given)
    return {
        "input_source": words,
        "evaluation": "A" if estimated else "B",
        "degrees_of_freedom": max(given.freedom, 1.0) if estimated else None,
    }


def _named_source(final: FittedModel, given: Contribution) -> tuple[str, bool]:
    """A source in words, and True if its size was estimated from measurements."""
    readings, survey = final.learned
    if given.source == OBSERVATIONS:
        return f"{_MEASURED[final.model.channel_word]}, at the noise found", True
    if given.source == INPUTS:
        word = final.model.channel_word
        kind = word if final.measured.size == 1 else "points" if final.model.part_count else "bodies"
        return _noise_source(_READ[kind], readings)
    if given.source == "shape":
        return _noise_source(_WORDS["shape"], survey)
    return _WORDS[given.source], False


def _noise_source(words: str, ratio: float) -> tuple[str, bool]:
    return (f"{words}, at the noise found", True) if ratio > _LARGER else (f"{words}, as declared", False)
