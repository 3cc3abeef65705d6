"""The certificate as a document: administrative data, conditions, results, statements."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, indent, tostring

from truing.report.uncertainty.section import KINDS, statement
from truing.runs.exports.certificate.elements import DCC, LANGUAGE, dcc, one_word, optional, rounded, si, text, words
from truing.runs.exports.certificate.qualified import Qualified, qualified, temperature
from truing.runs.exports.certificate.units import si_unit
from truing.schemas.certificate import Certificate, Contact, Item

if TYPE_CHECKING:
    import pandas as pd

    from truing.runs.recorded_run import Run

VERSION = "3.3.0"
FILE = "certificate.xml"
_INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"
_PROBABILITY = "0.95"
_NORMS = {"positioning": "ISO 230-2"}
_ALIKE = 2  # from so many results of one quantity on they stand as a list


def certificate(run: Run, told: Certificate) -> Iterator[tuple[str, bytes]]:
    """Yield the certificate of a run; ``told`` has to have all keys that a certificate needs."""
    found = qualified(run)
    root = Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": VERSION})
    root.set(f"{{{_INSTANCE}}}schemaLocation", f"{DCC} {DCC}/v{VERSION}/dcc.xsd")
    _administration(dcc(root, "administrativeData"), run, told, found)
    results = dcc(root, "measurementResults")

    def circumstances(result: Element) -> None:
        """What belongs to every result: PTB's rules look for it there."""
        _software(dcc(result, "usedSoftware"), run)
        if told.equipment:
            equipment = dcc(result, "measuringEquipments")
            for one in told.equipment:
                _item(dcc(equipment, "measuringEquipment"), one)
        _conditions(result, run, told)

    add_results(results, found.results, told.methods, circumstances)
    indent(root)
    yield FILE, tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _administration(parent: Element, run: Run, told: Certificate, found: Qualified) -> None:
    _software(dcc(parent, "dccSoftware"), run)
    _core(dcc(parent, "coreData"), told)
    _item(dcc(dcc(parent, "items"), "item"), told.item)
    laboratory = dcc(parent, "calibrationLaboratory")
    optional(laboratory, "calibrationLaboratoryCode", told.laboratory_code)
    _contact(dcc(laboratory, "contact"), told.laboratory)
    persons = dcc(parent, "respPersons")
    for place, person in enumerate(told.persons):
        entry = dcc(persons, "respPerson")
        text(dcc(entry, "person"), "name", str(person.name))
        optional(entry, "role", person.role)
        dcc(entry, "mainSigner", "false" if place else "true")
    _contact(dcc(parent, "customer"), told.customer)
    statements = dcc(parent, "statements")
    _statement(statements, "Uncertainty", statement(found.results))
    if found.omitted:
        _statement(statements, "Not in the uncertainty", *found.omitted)
    if found.left_out:
        _statement(statements, "Not certified", *found.left_out)
    if told.traceability:
        _statement(statements, "Traceability", told.traceability)


def _software(parent: Element, run: Run) -> None:
    """Every version that has made a table of the run."""
    for version in sorted({run.origin(name)["software_version"] for name in run}):
        software = dcc(parent, "software")
        text(software, "name", "truing")
        dcc(software, "release", version)
        dcc(software, "type", "application")


def _core(parent: Element, told: Certificate) -> None:
    dcc(parent, "countryCodeISO3166_1", told.country)
    for name in ("usedLangCodeISO639_1", "mandatoryLangCodeISO639_1"):
        dcc(parent, name, LANGUAGE)
    dcc(parent, "uniqueIdentifier", told.number)
    if told.order is not None:
        _identification(dcc(dcc(parent, "identifications"), "identification"), "customer", told.order, "order")
    optional(parent, "receiptDate", None if told.received is None else told.received.isoformat())
    dcc(parent, "beginPerformanceDate", str(told.begin))
    dcc(parent, "endPerformanceDate", str(told.end))
    dcc(parent, "performanceLocation", told.location)
    optional(parent, "issueDate", None if told.issued is None else told.issued.isoformat())


def _item(parent: Element, item: Item) -> None:
    text(parent, "name", str(item.name))
    if item.manufacturer is not None:
        text(dcc(parent, "manufacturer"), "name", item.manufacturer)
    optional(parent, "model", item.model)
    identification = dcc(dcc(parent, "identifications"), "identification")
    _identification(identification, item.issuer, str(item.identification), "identification")


def _identification(parent: Element, issuer: str, value: str, name: str) -> None:
    dcc(parent, "issuer", issuer)
    dcc(parent, "value", value)
    text(parent, "name", name)


def _contact(parent: Element, contact: Contact) -> None:
    text(parent, "name", str(contact.name))
    optional(parent, "eMail", contact.e_mail)
    optional(parent, "phone", contact.phone)
    location = dcc(parent, "location")
    places = (("street", contact.street), ("postCode", contact.post_code), ("city", contact.city))
    for name, value in (*places, ("countryCode", contact.country)):
        optional(location, name, value)


def _conditions(parent: Element, run: Run, told: Certificate) -> None:
    """The temperature of the item: as recorded, else as [certificate] tells it; even between its ends."""
    recorded = temperature(run)
    if recorded is not None:
        low, high, how = *recorded, "As recorded during the measurement."
    else:
        middle, half = told.temperature_c or 0.0, told.temperature_within_c or 0.0
        low, high, how = middle - half, middle + half, "As told by the laboratory."
    condition = dcc(dcc(parent, "influenceConditions"), "influenceCondition")
    text(condition, "name", "Temperature")
    text(condition, "description", how)
    quantity = dcc(dcc(condition, "data"), "quantity")
    text(quantity, "name", "Temperature")
    real = si(quantity, "real")
    si(real, "value", f"{0.5 * (low + high):.3f}")
    si(real, "unit", r"\degreecelsius")
    interval = si(si(real, "measurementUncertaintyUnivariate"), "coverageIntervalMU")
    si(interval, "valueStandardMU", f"{(high - low) / 12.0**0.5:.3f}")
    si(interval, "intervalMin", f"{low:.3f}")
    si(interval, "intervalMax", f"{high:.3f}")
    si(interval, "coverageProbability", "1")
    si(interval, "distribution", "uniform")


def _statement(parent: Element, name: str, *sentences: str) -> None:
    one = dcc(parent, "statement")
    text(one, "name", name)
    text(one, "declaration", *sentences)


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
