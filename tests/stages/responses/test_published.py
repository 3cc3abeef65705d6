"""Published displacements against those of a campaign: agreement, differences, and faults of bad tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from tests.blind.generator.sensor.campaign import draw_campaign
from tests.blind.generator.sensor.folder import write_campaign
from tests.blind.generator.sensor.layout import Programme
from tests.faults import assert_fault, faults_of
from tests.sentences import assert_says
from tests.stages.benches import DEFORMATION, layout
from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.formats.faultlog import FaultLog
from truing.formats.source import CampaignFiles
from truing.report.sensor.deformation import deformation
from truing.report.sensor.published import published_listing, published_sentence
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import read_campaign
from truing.simulation.bench.six_upur.nominal_sensor import SimulatedCompliance
from truing.stages.ingestion.published_values import read_published
from truing.stages.responses.published import compared_with_published

HEAD = "figure,load_axis,load,channel,unit,theoretical_maximum,measured_positive,measured_negative"
BAR = 1.959963985


def read(folder: Path, *rows: str, head: str = HEAD, files: dict | None = None) -> pa.Table:
    (folder / "published.csv").write_text("\n".join([head, *rows]) + "\n")
    campaign = read_campaign({"campaign": {"name": "c", "kind": "interferometer"}, "files": files or {}})
    log = FaultLog()
    found = read_published(CampaignFiles(folder, campaign), log)
    log.raise_faults()
    assert found is not None
    assert ARTIFACTS["published"].faults(found) == []
    return found


def test_every_value_becomes_a_row_with_the_sign_of_its_load(tmp_path):
    rows = read(tmp_path, "14,fz,9000,dz,um,336.5,428.21,-206.99", "15,mx,9000,rx,arcsec,,729.4,").to_pylist()
    assert [(r["load"], r["channel"], r["applied"], r["source"], r["published"]) for r in rows] == [
        ("fz", "dz", 9000.0, "theory", 336.5),
        ("fz", "dz", 9000.0, "measurement", 428.21),
        ("mx", "rx", 9000.0, "measurement", 729.4),
        ("fz", "dz", -9000.0, "measurement", -206.99),
    ]
    assert {(r["unit"], r["published_in"]) for r in rows} == {("um", "14"), ("arcsec", "15")}


def test_units_of_a_mapping_are_converted(tmp_path):
    mapping = {"published": {"path": "published.csv", "units": {"load": "kN", "measured_positive": "mm"}}}
    (row,) = read(
        tmp_path, "fz,9,dz,0.42821", head="load_axis,load,channel,measured_positive", files=mapping
    ).to_pylist()
    assert_close([row["applied"], row["published"]], [9000.0, 428.21], atol=1e-9)


@pytest.mark.parametrize(
    ("row", "column", "value", "expected"),
    [
        ("14,fz,-9000,dz,um,336.5,428.21,-206.99", "load", "-9000.0", "above 0"),
        ("14,fz,,dz,um,336.5,428.21,-206.99", "load", "", "above 0"),
        ("14,fz,9000,dz,arcsec,336.5,428.21,-206.99", "unit", "arcsec", "um"),
        ("14,fq,9000,dz,um,336.5,428.21,-206.99", "load_axis", "fq", "fx"),
        ("14,fz,9000,dw,um,336.5,428.21,-206.99", "channel", "dw", "dx"),
    ],
)
def test_a_bad_row_is_named_with_its_cure(tmp_path, row, column, value, expected):
    found = faults_of(lambda: read(tmp_path, "13,fy,9000,dy,um,1.0,1.0,-1.0", row))
    fault = assert_fault(found, file="published.csv", row=3, column=column, value=value)
    assert_says(fault.expected, expected)


def test_a_table_without_values_or_loads_and_a_repeated_row_are_faults(tmp_path):
    found = faults_of(lambda: read(tmp_path, "fz,9000,dz", head="load_axis,load,channel"))
    assert_says(found[0].expected, "theoretical_maximum", "measured_positive")
    found = faults_of(lambda: read(tmp_path, "fz,dz,1.0", head="load_axis,channel,measured_positive"))
    assert any("load" in str(fault) for fault in found)
    row = "14,fz,9000,dz,um,336.5,428.21,-206.99"
    assert_fault(faults_of(lambda: read(tmp_path, row, row)), row=3, column="channel")


def compared(published: list[tuple[str, float, float]], tolerance: float | None) -> list[dict]:
    """dz under fz of a sensor of 0.03 um/N: readings at 0 and 1000 N of 0 and 29.9 um, noise 0.1 um."""
    rows = [
        {"load": "fz", "channel": "dz", "applied": at, "source": source, "published": value, "unit": "um"}
        for source, at, value in published
    ]
    curve = {"load": "fz", "channel": "dz", "branch": "loading", "unit": "um", "sigma": 0.1}
    curves = pa.Table.from_pylist([{**curve, "applied": x, "measured": y} for x, y in ((0.0, 0.0), (1000.0, 29.9))])
    entries, covariance = np.zeros((6, 6)), np.zeros((36, 36))
    entries[2, 2], covariance[14, 14] = 3e-8, (3e-8 * (tolerance or 0.0)) ** 2
    simulated = None if tolerance is None else SimulatedCompliance(entries, covariance)
    table = compared_with_published(pa.Table.from_pylist(rows), curves, simulated).table()
    assert ARTIFACTS["published_compared"].faults(table) == []
    return table.to_pylist()


def test_theory_is_compared_with_the_simulation_and_measurement_with_measurement():
    """The limit of 95 %: tolerances once for theory; noise, and the tolerances of two specimens, for a measurement."""
    tolerance = 0.02 * 30.0
    limits = BAR * tolerance, BAR * np.hypot(0.1, np.sqrt(2.0) * tolerance)
    for side in (-1.0, 1.0):
        for share, verdict in ((0.99, "agrees"), (1.01, "differs")):
            values = [("theory", 1000.0, 30.0 + side * share * limits[0])]
            values.append(("measurement", 1000.0, 29.9 + side * share * limits[1]))
            rows = compared(values, 0.02)
            assert [row["verdict"] for row in rows] == [verdict] * 2
    assert_close([row["own"] for row in rows], [30.0, 29.9], atol=1e-9)
    assert_close([row["allowed_difference"] for row in rows], limits, atol=1e-6)


def test_a_load_between_two_applied_ones_is_interpolated_and_one_beyond_is_not_compared():
    half, beyond, other_way = compared(
        [("measurement", 500.0, 15.0), ("measurement", 2000.0, 60.0), ("measurement", -500.0, -15.0)], 0.02
    )
    assert_close(half["own"], 14.95, atol=1e-9)
    for row in (beyond, other_way):
        assert (row["own"], row["verdict"], row["allowed_difference"]) == (None, None, None)


def test_without_a_simulation_the_difference_is_shown_and_no_verdict_given():
    theory, measurement = compared([("theory", 1000.0, 30.0), ("measurement", 1000.0, 40.0)], None)
    assert (theory["own"], theory["verdict"]) == (None, None)
    assert (measurement["own"], measurement["verdict"]) == (29.9, None)
    listing = published_listing({"published_compared": pd.DataFrame([theory, measurement])})
    assert [row[4] for row in listing.rows] == ["no simulation", "29.90 ± 0.10"]
    assert [row[-1] for row in listing.rows] == ["not compared"] * 2
    assert listing.marks == ("none", "none")


def test_the_page_draws_the_published_values_and_says_which_differ(tmp_path):
    """True response 27 um/kN: a published 243 um at 9 kN agrees, 428 um does not."""
    made = layout(programme=Programme(axes=("fz",)))
    write_campaign(draw_campaign(made, [], np.random.default_rng(4)), tmp_path / "c", 4)
    (tmp_path / "c" / "published.csv").write_text(f"{HEAD}\n14,fz,9000,dz,um,336.5,243.0,-206.99\n")
    tables, _ = run_line(tmp_path / "c", *DEFORMATION)
    frames = {name: table.to_pandas() for name, table in tables.items() if not isinstance(table, str)}
    verdicts = frames["published_compared"].set_index(["source", "applied"])["verdict"]
    assert verdicts.tolist() == ["differs", "agrees", "differs"]
    section = deformation(frames)
    own = section.figures[0][0]
    theory, measured = (next(t for t in own.data if t.name == f"published {n}") for n in ("theory", "measurement"))
    assert_close(theory.x, [-9.0, 9.0], atol=1e-9)
    assert_close(theory.y, [-336.5, 336.5], atol=1e-9)
    assert sorted(zip(measured.x, measured.y, strict=True)) == [(-9.0, -206.99), (9.0, 243.0)]
    (said,) = published_sentence(frames)
    assert said in section.lead
    assert_says(said, "1 of 3", "dz under fz +9 kN (theory)", "dz under fz -9 kN (measurement)")
    listing = next(listing for listing in section.listings if listing.held_by == "published_compared.parquet")
    assert listing.marks == ("warn", "pass", "warn")
