"""Certificates contain only stated results and declared data, and are refused if they would claim more."""

from __future__ import annotations

import math
import os
import shutil
import tomllib
from collections import Counter
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import truing
from tests.faults import assert_fault, faults_of
from truing.estimation.uncertainty_budget import NOT_HELD
from truing.pipeline import recorded_runs
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode
from truing.pipeline.recorded_runs import certificate_files
from truing.runs.exports.certificate import certificate, one_line, one_word, rounded, si_unit
from truing.schemas.certificate import Certificate
from truing.schemas.faults import CampaignFaults

_NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
_TOML = (Path(__file__).parent / "certificate.toml").read_text()
STATED = Certificate.model_validate(tomllib.loads(_TOML)["certificate"])
# Folder of PTB's dcc.xsd 3.3.0 with all that it imports where it says: docs/how-to/certificate.md.
SCHEMA = "TRUING_DCC_SCHEMA"


@pytest.fixture(scope="module")
def run(workplace: Path) -> truing.Run:
    return truing.load(workplace / "runs" / "telescope")


@pytest.fixture
def campaign(workplace: Path, tmp_path: Path) -> Path:
    folder = shutil.copytree(workplace / "sample_data" / "telescope", tmp_path / "campaign")
    file = folder / "campaign.toml"
    start, _, rest = file.read_text().partition("[certificate]")  # the sample states less than a certificate needs
    file.write_text(f"{start}[mechanism]{rest.partition('[mechanism]')[2]}\n{_TOML}")
    return folder


def _with(run: truing.Run, name: str, change: Any) -> truing.Run:
    """The run with one of its tables changed."""
    table = run.table(name)
    changed = pa.Table.from_pandas(change(table.to_pandas()), schema=table.schema, preserve_index=False)
    return replace(run, _read={**run._read, name: changed.replace_schema_metadata(table.schema.metadata)})


def _read(run: truing.Run, described: Certificate = STATED) -> ElementTree.Element:
    ((name, content),) = certificate(run, described)
    assert name == "certificate.xml"
    return ElementTree.fromstring(content)


def _call(*words: object) -> Any:
    return CliRunner().invoke(app, ["export", *map(str, words)])


def test_every_stated_result_is_in_si_units_and_rounded(run: truing.Run) -> None:
    tree, stated = _read(run), run["uncertainty"]
    stated = stated[stated["stated"]]
    values = [v for one in tree.iterfind(".//si:valueXMLList", _NAMES) for v in (one.text or "").split()]
    single = tree.findall(".//dcc:results//si:real", _NAMES)
    assert len(values) + len(single) == len(stated)
    lists = tree.findall(".//si:realListXMLList", _NAMES)
    px = stated[(stated["result"] == "pose") & (stated["quantity"] == "px")]
    reported = [float(v) for v in (lists[0].findtext("si:valueXMLList", "", _NAMES)).split()]
    assert lists[0].findtext("si:unitXMLList", "", _NAMES) == r"\metre"
    half = (lists[0].findtext(".//si:valueExpandedMUXMLList", "", _NAMES)).split()
    assert reported == pytest.approx(
        (1e-3 * px["estimate"]).tolist(), abs=0.006 * 1e-3 * px["expanded_uncertainty"].max()
    )
    assert [float(u) for u in half] == pytest.approx((1e-3 * px["expanded_uncertainty"]).tolist(), rel=0.051)
    assert all(len(u.partition("E")[0].replace(".", "").lstrip("0")) == 2 for u in half)
    for factor in tree.iterfind(".//si:coverageFactorXMLList", _NAMES):
        assert all(float(k) >= 1.0 for k in (factor.text or "").split())


def test_certificate_data_are_in_the_elements_of_the_schema(run: truing.Run) -> None:
    tree = _read(run)
    core = tree.find("dcc:administrativeData/dcc:coreData", _NAMES)
    assert core is not None
    assert [child.tag.partition("}")[2] for child in core] == [
        *("countryCodeISO3166_1", "usedLangCodeISO639_1", "mandatoryLangCodeISO639_1", "uniqueIdentifier"),
        *("identifications", "receiptDate", "beginPerformanceDate", "endPerformanceDate", "performanceLocation"),
    ]
    assert core.findtext("dcc:endPerformanceDate", "", _NAMES) == "2026-11-05"
    customer = tree.find("dcc:administrativeData/dcc:customer", _NAMES)
    assert customer is not None
    assert "".join(customer.itertext()).split() == ["Customer", "&", "Sons", "Oslo", "NO"]
    signers = [one.text for one in tree.iterfind(".//dcc:mainSigner", _NAMES)]
    assert signers == ["true", "false"]
    interval = tree.find(".//dcc:influenceCondition//si:coverageIntervalMU", _NAMES)
    assert interval is not None
    recorded = run["configurations"]["temperature_c"]
    assert [interval[k].text for k in (1, 2)] == [f"{recorded.min():.3f}", f"{recorded.max():.3f}"]


def test_an_unrecorded_temperature_is_taken_from_the_settings(run: truing.Run) -> None:
    unknown = _with(run, "configurations", lambda rows: rows.assign(temperature_c=float("nan")))
    interval = _read(unknown).find(".//dcc:influenceCondition//si:coverageIntervalMU", _NAMES)
    assert interval is not None
    assert [child.text for child in interval] == ["0.173", "19.800", "20.400", "1", "uniform"]


def test_the_certificate_keeps_the_rules_of_ptb_that_no_schema_states(run: truing.Run) -> None:
    tree = _read(run)
    for parent in tree.iter():
        languages = [content.get("lang") for content in parent.findall("dcc:content", _NAMES)]
        assert languages in ([], ["en"])
    for result in tree.iterfind(".//dcc:measurementResult", _NAMES):
        names = [child.tag.partition("}")[2] for child in result]
        assert names[2:] == ["usedMethods", "usedSoftware", "measuringEquipments", "influenceConditions", "results"]
    for unit in (*tree.iter("{https://ptb.de/si}unit"), *tree.iter("{https://ptb.de/si}unitXMLList")):
        assert len((unit.text or "").split()) == 1
    for name in ("valueXMLList", "labelXMLList", "coverageFactorXMLList", "distributionXMLList"):
        for reported in tree.iter(f"{{https://ptb.de/si}}{name}"):
            assert reported.text == " ".join((reported.text or "").split())


def test_equal_runs_give_equal_certificates(run: truing.Run) -> None:
    assert dict(certificate(run, STATED)) == dict(certificate(run, STATED))


@pytest.mark.skipif(SCHEMA not in os.environ, reason=f"{SCHEMA} names no folder with dcc.xsd of PTB, version 3.3.0")
def test_the_certificate_is_valid_by_the_schema_of_ptb(run: truing.Run) -> None:
    etree = pytest.importorskip("lxml.etree", reason="lxml is not installed")
    schema = etree.XMLSchema(etree.parse(str(Path(os.environ[SCHEMA]) / "dcc.xsd")))
    hostile = STATED.model_copy(update={"number": "a\x00\x0b ]]> <b>\t&amp;\ud800"})
    for reported in (STATED, hostile):
        ((_, content),) = certificate(run, reported)
        schema.assertValid(etree.fromstring(content))


def test_the_command_writes_it_and_says_everything_that_is_missing_at_once(workplace: Path, campaign: Path) -> None:
    place = workplace / "runs" / "telescope"
    done = _call(place, "--to", "dcc", "--campaign", campaign, "--out", campaign / "out")
    assert done.exit_code == ExitCode.DONE, done.output
    assert ElementTree.parse(campaign / "out" / "certificate.xml").getroot().get("schemaVersion") == "3.3.0"
    file = campaign / "campaign.toml"
    text = file.read_text().replace('number = "K', '# number = "K').replace('city = "Oslo"', "")
    file.write_text(text.replace("end = 2026-11-05", "end = 2026-11-01"))
    done = _call(place, "--to", "dcc", "--campaign", campaign, "--out", campaign / "none")
    assert done.exit_code == ExitCode.UNUSABLE_CAMPAIGN
    for key in ("certificate.number", "certificate.customer.city", "certificate.end"):
        assert key in done.output
    assert not list((campaign / "none").iterdir())
    assert "--campaign: expected" in _call(place, "--to", "dcc").output


def test_other_campaigns_and_failed_checks_are_refused(
    run: truing.Run, campaign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed = _with(run, "qa", lambda qa: qa.assign(verdict=["fail", *qa["verdict"][1:]]))
    monkeypatch.setattr(recorded_runs, "opened_run", lambda folder: failed)
    done = _call(run.folder, "--to", "dcc", "--campaign", campaign, "--out", campaign / "out")
    assert done.exit_code == ExitCode.FAILED_CHECK
    assert str(run["qa"]["check"][0]) in done.output
    none = _with(run, "uncertainty", lambda described: described.assign(stated=False))
    with pytest.raises(CampaignFaults, match="results with an uncertainty"):
        certificate_files(none, campaign)
    file = campaign / "campaign.toml"
    file.write_text(file.read_text().replace('name = "telescope"', 'name = "another"'))
    faults = faults_of(lambda: certificate_files(run, campaign))
    assert_fault(faults, file="--campaign", value="another", expected="the campaign telescope")


def test_results_that_are_off_by_a_cause_they_do_not_hold_are_not_certified(run: truing.Run) -> None:
    def off(parts: pd.DataFrame) -> pd.DataFrame:
        row = {**dict.fromkeys(parts, None), "result": "pose", "quantity": "all", "evaluation": "not evaluated"}
        return pd.concat([parts, pd.DataFrame([{**row, "input_source": "measurement-scale", "reason": NOT_HELD}])])

    said = "".join(_read(_with(run, "uncertainty_budget", off)).itertext())
    assert "Poses: measurement-scale" in said
    assert "platform in base" not in said
    assert "platform in base" in "".join(_read(run).itertext())


def _with_verdict(run: truing.Run, section: str, state: str, code: str) -> truing.Run:
    """The run with another verdict on one section."""

    def change(rows: pd.DataFrame) -> pd.DataFrame:
        own = rows["section"] == section
        return rows.assign(
            state=rows["state"].where(~own, state),
            reason_code=rows["reason_code"].where(~own, code),
            value=rows["value"].where(~own, 2.6),
            limit=rows["limit"].where(~own, 2.0),
        )

    return _with(run, "verdict", change)


@pytest.mark.parametrize(
    ("section", "state", "code"),
    [
        ("adequacy", "fails", "beyond-noise"),
        ("adequacy", "attention", "lack-of-fit"),
        ("pulls", "fails", "beyond-tolerance"),
        ("calibration", "fails", "misfit"),
    ],
)
def test_no_number_of_a_model_that_fails_is_certified(run: truing.Run, section: str, state: str, code: str) -> None:
    said = "".join(_read(_with_verdict(run, section, state, code)).itertext())
    explanation = run["verdict"].set_index("section").loc[section, "explanation"]
    assert f"{section}: {state} ({code}, value 2.60, limit 2). {' '.join(explanation.split())}" in " ".join(
        said.split()
    )
    kinds = {
        row.findtext("dcc:name/dcc:content", "", _NAMES)
        for row in _measurements(_with_verdict(run, section, state, code))
    }
    assert kinds == {"Poses"}
    assert {"Poses", "Parameters of the mechanism"} <= {
        row.findtext("dcc:name/dcc:content", "", _NAMES) for row in _measurements(run)
    }


def _measurements(run: truing.Run) -> list[ElementTree.Element]:
    return _read(run).findall(".//dcc:measurementResult", _NAMES)


@pytest.mark.parametrize(
    ("section", "state", "code"), [("diagnosis", "fails", "found"), ("pulls", "attention", "misfit")]
)
def test_harmless_verdicts_leave_all_measurements_certified(
    run: truing.Run, section: str, state: str, code: str
) -> None:
    assert len(_measurements(_with_verdict(run, section, state, code))) == len(_measurements(run))


def test_poses_of_bodies_that_their_survey_does_not_explain_are_not_certified(
    run: truing.Run, campaign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bodies = _with(run, "diagnosis", lambda rows: rows.assign(relation="bodies-survey"))
    assert len(_measurements(bodies)) == len(_measurements(run))
    failing = _with_verdict(bodies, "adequacy", "fails", "beyond-noise")
    monkeypatch.setattr(recorded_runs, "opened_run", lambda folder: failing)
    done = _call(run.folder, "--to", "dcc", "--campaign", campaign, "--out", campaign / "out")
    assert done.exit_code == ExitCode.FAILED_CHECK
    for word in ("no certificate", "adequacy: fails", "value 2.60", "limit 2", "run again"):
        assert word in " ".join(done.output.split())
    assert not list((campaign / "out").iterdir())


def test_the_command_says_what_was_not_certified(
    run: truing.Run, campaign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        recorded_runs, "opened_run", lambda folder: _with_verdict(run, "pulls", "fails", "beyond-tolerance")
    )
    done = _call(run.folder, "--to", "dcc", "--campaign", campaign, "--out", campaign / "out")
    assert done.exit_code == ExitCode.DONE
    assert "not certified: Parameters of the mechanism" in " ".join(done.output.split())


def test_data_that_do_not_belong_together_are_not_certified(
    run: truing.Run, campaign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing = _with_verdict(run, "belonging", "fails", "do-not-belong")
    monkeypatch.setattr(recorded_runs, "opened_run", lambda folder: failing)
    done = _call(run.folder, "--to", "dcc", "--campaign", campaign, "--out", campaign / "out")
    assert done.exit_code == ExitCode.FAILED_CHECK
    assert "belonging" in done.output


@settings(max_examples=40)
@given(st.text(min_size=1, max_size=40), st.text(min_size=1, max_size=40))
def test_no_text_breaks_the_document_and_words_survive(name: str, label: str) -> None:
    element = ElementTree.Element("a")
    element.text = one_line(name)
    again = ElementTree.fromstring(ElementTree.tostring(element, encoding="utf-8"))
    assert (again.text or "") == one_line(name)
    plain = "".join(c for c in name if c.isalnum() and c.isascii())
    assert Counter(plain) <= Counter(element.text)
    assert len(one_word(label).split()) == 1


@pytest.mark.parametrize(
    ("unit", "factor", "written"),
    [
        ("mm", 1e-3, r"\metre"),
        ("m/(N m)", 1.0, r"\metre\newton\tothe{-1}\metre\tothe{-1}"),
        ("N m/mV", 1e3, r"\newton\metre\volt\tothe{-1}"),
        ("um/h", 1e-6 / 3600.0, r"\metre\second\tothe{-1}"),
        ("1/K", 1.0, r"\kelvin\tothe{-1}"),
        ("um/mm2", 1.0, r"\metre\metre\tothe{-2}"),
        ("arcsec", math.pi / 648000.0, r"\radian"),
        ("1", 1.0, r"\one"),
    ],
)
def test_units_are_those_of_the_si(unit: str, factor: float, written: str) -> None:
    assert si_unit(unit) == (pytest.approx(factor), written)


def test_a_unit_without_a_name_in_the_si_is_none() -> None:
    assert si_unit("furlong/N") is None


@settings(max_examples=50)
@given(st.floats(-1e6, 1e6), st.floats(1e-12, 1e3))
def test_estimate_and_uncertainty_end_at_the_same_place(value: float, uncertainty: float) -> None:
    reported, half = rounded(value, uncertainty)
    assert abs(float(reported) - value) <= 0.0501 * uncertainty + 1e-15 * abs(value)
    assert float(half) == pytest.approx(uncertainty, rel=0.0501)


def test_a_certificate_shows_what_it_needs() -> None:
    assert not list(STATED.missing(temperature_known=False))
    assert len(list(Certificate().missing(temperature_known=True))) == 14
    assert len(list(Certificate().missing(temperature_known=False))) == 16
    assert STATED.begin == date(2026, 11, 2)
