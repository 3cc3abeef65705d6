"""The certificate as a document: administrative data, conditions, results, statements."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, indent, tostring

from schemas.certificate import Certificate, Contact, Item
from truing.report.uncertainty.section import statement
from truing.runs.exports.certificate.elements import DCC, LANGUAGE, dcc, optional, si, text
from truing.runs.exports.certificate.qualified import Qualified, qualified, temperature
from truing.runs.exports.certificate.results import add_results

if TYPE_CHECKING:
    from truing.runs.recorded_run import Run

VERSION = "3.3.0"
FILE = "certificate.xml"
_INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"


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
