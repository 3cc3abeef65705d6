"""Calibration certificate of a run as DCC XML: certified results, administrative data, conditions, statements."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from xml.etree.ElementTree import Element, SubElement, indent, register_namespace, tostring

import pandas as pd

from truing.belonging.relation import RelationState
from truing.estimation.uncertainty_budget import NOT_HELD
from truing.report.numbers import plain
from truing.report.tables import Row
from truing.report.uncertainty_section import TITLES_BY_KIND, statement
from truing.runs.recorded_run import Run
from truing.schemas.certificate import Certificate, Contact, Item
from truing.schemas.verdict import INCOMPLETE, OF_MODEL, Relation

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
_LANGUAGE = "en"
# Characters that XML 1.0 does not allow, escaped or not.
_NO_CHARACTER = re.compile(r"[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

register_namespace("dcc", DCC)
register_namespace("si", SI)

_BASE = {
    "mm": (1e-3, r"\metre"),
    "um": (1e-6, r"\metre"),
    "m": (1.0, r"\metre"),
    "rad": (1.0, r"\radian"),
    "mrad": (1e-3, r"\radian"),
    "urad": (1e-6, r"\radian"),
    "arcsec": (math.pi / 648000.0, r"\radian"),
    "deg": (math.pi / 180.0, r"\radian"),
    "N": (1.0, r"\newton"),
    "V": (1.0, r"\volt"),
    "mV": (1e-3, r"\volt"),
    "K": (1.0, r"\kelvin"),
    "s": (1.0, r"\second"),
    "min": (60.0, r"\second"),
    "h": (3600.0, r"\second"),
    "Hz": (1.0, r"\hertz"),
    "Pa": (1.0, r"\pascal"),
    "hPa": (1e2, r"\pascal"),
    "%": (1e-2, ""),
    "1": (1.0, ""),
}
_PART = re.compile(r"^([A-Za-z%]+|1)\^?(-?\d+)?$")

_VERSION = "3.3.0"
FILE = "certificate.xml"
_INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"
_PROBABILITY = "0.95"
_NORMS = {"positioning": "ISO 230-2"}
# Kinds of result that are measured and need no model of the machine.
_MEASURED = ("pose", "positioning")
_TO_DO = "Its results are not certified: correct [noise] and tolerances, or find the missing cause, and run again."
_ALIKE = 2  # fewest results of one quantity that are written as a list


def dcc(parent: Element, name: str, text: str | None = None) -> Element:
    """Append an element of the certificate's namespace."""
    return _append(parent, f"{{{DCC}}}{name}", text)


def si(parent: Element, name: str, text: str | None = None) -> Element:
    """Append an element of D-SI."""
    return _append(parent, f"{{{SI}}}{name}", text)


def _append(parent: Element, tag: str, text: str | None) -> Element:
    child = SubElement(parent, tag)
    child.text = None if text is None else one_line(text)
    return child


def one_line(text: str) -> str:
    """Return a text in one line, without characters that XML cannot hold."""
    return " ".join(_NO_CHARACTER.sub("\ufffd", str(text)).split())


def one_word(text: str) -> str:
    """Return a text without blanks, for a list separated by blanks."""
    return one_line(text).replace(" ", "_") or "_"


def text(parent: Element, name: str, *sentences: str) -> Element:
    """Append a named element with one content in the language of the certificate."""
    child = dcc(parent, name)
    dcc(child, "content", " ".join(sentences)).set("lang", _LANGUAGE)
    return child


def optional(parent: Element, name: str, value: str | None) -> None:
    """Append an element if it has a value."""
    if value is not None:
        dcc(parent, name, value)


def rounded(value: float, uncertainty: float) -> tuple[str, str]:
    """Return an estimate and its expanded uncertainty of two significant digits, both to the same place (GUM 7.2.6)."""
    reported = Decimal(f"{uncertainty:.1e}")
    return str(Decimal(repr(value)).quantize(reported)), str(reported)


def words(values: Iterable[str]) -> str:
    """Return a list in the format of D-SI."""
    return " ".join(values)


def si_unit(unit: str) -> tuple[float, str] | None:
    """Return the factor to SI and the D-SI unit of ``N m/mV``, ``1/K``, ``m/(N m)``; None for an unknown unit."""
    parts = unit.strip().split("/")
    factor, written = 1.0, []
    for index, part in enumerate(parts):
        for token in part.strip().strip("()").replace("*", " ").split():
            match = _PART.match(token)
            if match is None or match[1] not in _BASE:
                return None
            power = int(match[2] or 1) * (-1 if index else 1)
            scale, name = _BASE[match[1]]
            factor *= scale**power
            if name:
                written.append(name if power == 1 else rf"{name}\tothe{{{power}}}")
    return factor, "".join(written) or r"\one"


@dataclass(frozen=True)
class _Qualified:
    """Results to be certified, as rows of ``uncertainty``; sentences on results left out and on effects
    in no budget."""

    results: pd.DataFrame
    left_out: tuple[str, ...]
    omitted: tuple[str, ...]


def failed_checks(run: Run) -> list[str]:
    """Return the failed checks of a run that no person has accepted."""
    if "qa" not in run:
        return []
    checks = run["qa"]
    failed = checks[checks["verdict"] == "fail"]
    if "accepted" in failed:
        failed = failed[failed["accepted"].isna()]
    return sorted({f"{row.check} {row.subject or ''}".strip() for row in failed.itertuples()})


def doubts(run: Run) -> list[str]:
    """Return a sentence per section of the verdict in which the run's model fails or is incomplete."""
    rows = run.verdict
    doubted = rows["state"].eq(RelationState.FAILS.value) | rows["reason_code"].isin(
        [code.value for code in INCOMPLETE]
    )
    doubted_rows = rows[rows["section"].isin(OF_MODEL) & doubted]
    return [
        f"{row.section}: {row.state} ({_size(row)}). {row.explanation} {_TO_DO}" for row in doubted_rows.itertuples()
    ]


def _size(row: Row) -> str:
    """Return the figure behind a state, with its limit if it has one."""
    parts = [f"{name} {plain(size)}" for name, size in (("value", row.value), ("limit", row.limit)) if size == size]
    return ", ".join([str(row.reason_code), *parts])


def _model_based_results(run: Run) -> list[str]:
    """Return the kinds of result that follow from a model; poses too, if a searched relation has no
    simulated machine."""
    relations = run["diagnosis"]["relation"].dropna().unique() if "diagnosis" in run else ()
    measured = _MEASURED if all(Relation(name).is_simulated for name in relations) else _MEASURED[1:]
    return [kind for kind in TITLES_BY_KIND if kind not in measured]


def valid_results(run: Run) -> _Qualified:
    """Return the results with a valid uncertainty: not those of a model that fails, or that omits a cause that was
    found."""
    stated, parts = run["uncertainty"], run["uncertainty_budget"]
    good = stated[stated["stated"] & stated["estimate"].notna() & (stated["expanded_uncertainty"] > 0.0)]
    good = good[good["coverage_factor"] >= 1.0]  # D-SI allows no others
    left_out = []
    if doubted := doubts(run):
        kinds = [kind for kind in _model_based_results(run) if (good["result"] == kind).any()]
        good = good[~good["result"].isin(kinds)]
        left_out += [f"{', '.join(TITLES_BY_KIND[kind] for kind in kinds)}: {' '.join(doubted)}"] if kinds else []
    for kind, off in _biasing_causes(parts).items():
        if (good["result"] == kind).any():
            good = good[good["result"] != kind]
            left_out.append(f"{TITLES_BY_KIND[kind]}: {', '.join(off)}: {NOT_HELD}.")
    unknown = [unit for unit in dict.fromkeys(good["unit"].fillna("1")) if si_unit(unit) is None]
    if unknown:
        good = good[~good["unit"].fillna("1").isin(unknown)]
        left_out.append(f"Results in units without an SI name: {', '.join(unknown)}.")
    reported = parts[(parts["evaluation"] == "not evaluated") & parts["result"].isin(good["result"])]
    omitted = [f"{row.result}: {row.input_source} ({row.reason})." for row in reported.itertuples()]
    return _Qualified(good, tuple(left_out), tuple(dict.fromkeys(omitted)))


def _biasing_causes(parts: pd.DataFrame) -> dict[str, list[str]]:
    """Return by kind of result the causes that bias its estimates and that its uncertainty does not cover."""
    rows = parts[parts["reason"] == NOT_HELD]
    return {str(kind): list(dict.fromkeys(group["input_source"])) for kind, group in rows.groupby("result", sort=False)}


def temperature(run: Run) -> tuple[float, float] | None:
    """Return the lowest and the highest recorded temperature, degrees C; None where none was recorded."""
    for table, column in (
        *(("configurations", "temperature_c"), ("readings", "material_temperature_c")),
        *(("signals", "material_temperature_c"), ("positions", "material_temperature_c")),
        *(("readings", "air_temperature_c"), ("signals", "air_temperature_c"), ("positions", "air_temperature_c")),
    ):
        values = run[table][column].dropna() if table in run and column in run[table] else None
        if values is not None and len(values):
            return float(values.min()), float(values.max())
    return None


def certificate(run: Run, document: Certificate) -> Iterator[tuple[str, bytes]]:
    """Yield the certificate of a run; ``document`` must have all keys that a certificate needs."""
    qualified = valid_results(run)
    root = Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": _VERSION})
    root.set(f"{{{_INSTANCE}}}schemaLocation", f"{DCC} {DCC}/v{_VERSION}/dcc.xsd")
    _administration(dcc(root, "administrativeData"), run, document, qualified)
    results = dcc(root, "measurementResults")

    def circumstances(result: Element) -> None:
        """Conditions that belong to every result; PTB's rules look for them there."""
        _software(dcc(result, "usedSoftware"), run)
        if document.equipment:
            equipment = dcc(result, "measuringEquipments")
            for one in document.equipment:
                _item(dcc(equipment, "measuringEquipment"), one)
        _conditions(result, run, document)

    _add_results(results, qualified.results, document.methods, circumstances)
    indent(root)
    yield FILE, tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _administration(parent: Element, run: Run, document: Certificate, found: _Qualified) -> None:
    _software(dcc(parent, "dccSoftware"), run)
    _core(dcc(parent, "coreData"), document)
    _item(dcc(dcc(parent, "items"), "item"), document.item)
    laboratory = dcc(parent, "calibrationLaboratory")
    optional(laboratory, "calibrationLaboratoryCode", document.laboratory_code)
    _contact(dcc(laboratory, "contact"), document.laboratory)
    persons = dcc(parent, "respPersons")
    for index, person in enumerate(document.persons):
        entry = dcc(persons, "respPerson")
        text(dcc(entry, "person"), "name", str(person.name))
        optional(entry, "role", person.role)
        dcc(entry, "mainSigner", "false" if index else "true")
    _contact(dcc(parent, "customer"), document.customer)
    statements = dcc(parent, "statements")
    _statement(statements, "Uncertainty", statement(found.results))
    if found.omitted:
        _statement(statements, "Not in the uncertainty", *found.omitted)
    if found.left_out:
        _statement(statements, "Not certified", *found.left_out)
    if document.traceability:
        _statement(statements, "Traceability", document.traceability)


def _software(parent: Element, run: Run) -> None:
    """Append every version of the software that wrote a table of the run."""
    for version in sorted({run.origin(name)["software_version"] for name in run}):
        software = dcc(parent, "software")
        text(software, "name", "truing")
        dcc(software, "release", version)
        dcc(software, "type", "application")


def _core(parent: Element, document: Certificate) -> None:
    dcc(parent, "countryCodeISO3166_1", document.country)
    for name in ("usedLangCodeISO639_1", "mandatoryLangCodeISO639_1"):
        dcc(parent, name, _LANGUAGE)
    dcc(parent, "uniqueIdentifier", document.number)
    if document.order is not None:
        _identification(dcc(dcc(parent, "identifications"), "identification"), "customer", document.order, "order")
    optional(parent, "receiptDate", None if document.received is None else document.received.isoformat())
    dcc(parent, "beginPerformanceDate", str(document.begin))
    dcc(parent, "endPerformanceDate", str(document.end))
    dcc(parent, "performanceLocation", document.location)
    optional(parent, "issueDate", None if document.issued is None else document.issued.isoformat())


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
    lines = (("street", contact.street), ("postCode", contact.post_code), ("city", contact.city))
    for name, value in (*lines, ("countryCode", contact.country)):
        optional(location, name, value)


def _conditions(parent: Element, run: Run, document: Certificate) -> None:
    """Append the temperature of the item as recorded, else as in [certificate]; uniform between its limits."""
    recorded = temperature(run)
    if recorded is not None:
        low, high, how = *recorded, "As recorded during the measurement."
    else:
        middle, half = document.temperature_c or 0.0, document.temperature_within_c or 0.0
        low, high, how = middle - half, middle + half, "As stated by the laboratory."
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


def _add_results(
    parent: Element, results: pd.DataFrame, methods: tuple[str, ...], circumstances: Callable[[Element], None]
) -> None:
    """Append a measurement result per kind, in the order of the page; ``circumstances`` appends its conditions."""
    for kind, title in TITLES_BY_KIND.items():
        rows_of_kind = results[results["result"] == kind]
        if len(rows_of_kind):
            _kind(parent, kind, title, rows_of_kind, methods, circumstances)


def _kind(
    parent: Element,
    kind: str,
    title: str,
    rows_of_kind: pd.DataFrame,
    methods: tuple[str, ...],
    circumstances: Callable[[Element], None],
) -> None:
    result = dcc(parent, "measurementResult")
    text(result, "name", title)
    text(result, "description", statement(rows_of_kind))
    used = dcc(result, "usedMethods")
    _method(used, "Evaluation of uncertainty: Guide to the expression of uncertainty in measurement", "JCGM 100:2008")
    if kind in _NORMS:
        _method(used, "Positioning of an axis", _NORMS[kind])
    for name in methods:
        _method(used, name)
    circumstances(result)
    results_node = dcc(result, "results")
    for subject, rows in (
        rows_of_kind.groupby("subject", sort=False, dropna=False) if kind != "pose" else _by_body(rows_of_kind)
    ):
        result_node = dcc(results_node, "result")
        text(result_node, "name", str(subject) if isinstance(subject, str) and subject.strip() else title)
        data = dcc(result_node, "data")
        for quantity, alike in rows.groupby("quantity", sort=False):
            _quantity(data, str(quantity), alike)


def _by_body(rows_of_bodies: pd.DataFrame) -> Iterable[tuple[object, pd.DataFrame]]:
    """Group poses by body, which precedes the pose in their subject."""
    return rows_of_bodies.groupby(rows_of_bodies["subject"].str.partition(", pose ")[0], sort=False)


def _method(parent: Element, name: str, norm: str | None = None) -> None:
    method = dcc(parent, "usedMethod")
    text(method, "name", name)
    if norm is not None:
        dcc(method, "norm", norm)


def _quantity(parent: Element, name: str, rows: pd.DataFrame) -> None:
    quantity = dcc(parent, "quantity")
    text(quantity, "name", name)
    reported = [_number(row) for row in rows.itertuples()]
    unit = _unit(rows["unit"].iloc[0])[1]
    alike = [one_word(str(subject).rpartition(", ")[2]) for subject in rows["subject"]]
    _numbers(quantity, [one_word(name)] if len(rows) < _ALIKE else alike, unit, reported)


def _unit(unit: object) -> tuple[float, str]:
    unit_si = si_unit(unit if isinstance(unit, str) else "1")
    assert unit_si is not None, unit
    return unit_si


def _number(row: Row) -> tuple[str, str, str, str]:
    """Return value, expanded uncertainty, coverage factor and distribution, in SI units."""
    factor = _unit(row.unit)[0]
    value, uncertainty = rounded(factor * row.estimate, abs(factor) * row.expanded_uncertainty)
    law = "normal" if row.degrees_of_freedom != row.degrees_of_freedom else "t"
    return value, uncertainty, f"{row.coverage_factor:.2f}", "drawn" if row.result == "positioning" else law


def _numbers(parent: Element, labels: list[str], unit: str, reported: list[tuple[str, str, str, str]]) -> None:
    """Append one number with its uncertainty, or several as a list of D-SI."""
    many = "XMLList" if len(reported) >= _ALIKE else ""
    values, uncertainties, factors, laws = (words(column) for column in zip(*reported, strict=True))
    real = si(parent, f"realList{many}" if many else "real")
    for tag, content in (("label", words(labels)), ("value", values), ("unit", unit)):
        si(real, f"{tag}{many}", content)
    uncertainty_node = si(si(real, f"measurementUncertaintyUnivariate{many}"), f"expandedMU{many}")
    for tag, content in (("valueExpandedMU", uncertainties), ("coverageFactor", factors)):
        si(uncertainty_node, f"{tag}{many}", content)
    si(uncertainty_node, f"coverageProbability{many}", _PROBABILITY)
    si(uncertainty_node, f"distribution{many}", laws)
