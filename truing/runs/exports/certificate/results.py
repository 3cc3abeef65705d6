"""Measurement results of a certificate: every quantity with its expanded uncertainty, coverage factor and law."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element

from truing.report.uncertainty.section import KINDS, statement
from truing.runs.exports.certificate.elements import dcc, one_word, rounded, si, text, words
from truing.runs.exports.certificate.units import si_unit

if TYPE_CHECKING:
    import pandas as pd

_PROBABILITY = "0.95"
_NORMS = {"positioning": "ISO 230-2"}
_ALIKE = 2  # from so many results of one quantity on they stand as a list


def add_results(
    parent: Element, results: pd.DataFrame, methods: tuple[str, ...], circumstances: Callable[[Element], None]
) -> None:
    """Append a measurement result per kind, in the order of the page; ``circumstances`` appends those of each."""
    for kind, title in KINDS.items():
        own = results[results["result"] == kind]
        if len(own):
            _kind(parent, kind, title, own, methods, circumstances)


def _kind(
    parent: Element,
    kind: str,
    title: str,
    own: pd.DataFrame,
    methods: tuple[str, ...],
    circumstances: Callable[[Element], None],
) -> None:
    result = dcc(parent, "measurementResult")
    text(result, "name", title)
    text(result, "description", statement(own))
    used = dcc(result, "usedMethods")
    _method(used, "Evaluation of uncertainty: Guide to the expression of uncertainty in measurement", "JCGM 100:2008")
    if kind in _NORMS:
        _method(used, "Positioning of an axis", _NORMS[kind])
    for name in methods:
        _method(used, name)
    circumstances(result)
    found = dcc(result, "results")
    for subject, rows in own.groupby("subject", sort=False, dropna=False) if kind != "pose" else _by_body(own):
        one = dcc(found, "result")
        text(one, "name", str(subject) if isinstance(subject, str) and subject.strip() else title)
        data = dcc(one, "data")
        for quantity, alike in rows.groupby("quantity", sort=False):
            _quantity(data, str(quantity), alike)


def _by_body(own: pd.DataFrame) -> Any:
    """Poses of one body together: what stands before the pose in their subject."""
    return own.groupby(own["subject"].str.partition(", pose ")[0], sort=False)


def _method(parent: Element, name: str, norm: str | None = None) -> None:
    method = dcc(parent, "usedMethod")
    text(method, "name", name)
    if norm is not None:
        dcc(method, "norm", norm)


def _quantity(parent: Element, name: str, rows: pd.DataFrame) -> None:
    quantity = dcc(parent, "quantity")
    text(quantity, "name", name)
    told = [_number(row) for row in rows.itertuples()]
    unit = _unit(rows["unit"].iloc[0])[1]
    if len(rows) < _ALIKE:
        _single(quantity, name, unit, told[0])
    else:
        labels = [one_word(str(subject).rpartition(", ")[2]) for subject in rows["subject"]]
        _list(quantity, labels, unit, told)


def _unit(unit: Any) -> tuple[float, str]:
    found = si_unit(unit if isinstance(unit, str) else "1")
    assert found is not None, unit
    return found


def _number(row: Any) -> tuple[str, str, str, str]:
    """Value, expanded uncertainty, coverage factor and distribution, in SI units."""
    factor = _unit(row.unit)[0]
    value, uncertainty = rounded(factor * row.estimate, abs(factor) * row.expanded_uncertainty)
    law = "normal" if row.degrees_of_freedom != row.degrees_of_freedom else "t"
    return value, uncertainty, f"{row.coverage_factor:.2f}", "drawn" if row.result == "positioning" else law


def _single(parent: Element, name: str, unit: str, told: tuple[str, str, str, str]) -> None:
    value, uncertainty, factor, law = told
    real = si(parent, "real")
    si(real, "label", one_word(name))
    si(real, "value", value)
    si(real, "unit", unit)
    own = si(si(real, "measurementUncertaintyUnivariate"), "expandedMU")
    for tag, content in (("valueExpandedMU", uncertainty), ("coverageFactor", factor)):
        si(own, tag, content)
    si(own, "coverageProbability", _PROBABILITY)
    si(own, "distribution", law)


def _list(parent: Element, labels: list[str], unit: str, told: list[tuple[str, str, str, str]]) -> None:
    values, uncertainties, factors, laws = (words(column) for column in zip(*told, strict=True))
    real = si(parent, "realListXMLList")
    si(real, "labelXMLList", words(labels))
    si(real, "valueXMLList", values)
    si(real, "unitXMLList", unit)
    own = si(si(real, "measurementUncertaintyUnivariateXMLList"), "expandedMUXMLList")
    si(own, "valueExpandedMUXMLList", uncertainties)
    si(own, "coverageFactorXMLList", factors)
    si(own, "coverageProbabilityXMLList", _PROBABILITY)
    si(own, "distributionXMLList", laws)
