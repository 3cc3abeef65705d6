"""docs/causes.md is current: its catalogue, its comparisons, and every cause."""

from __future__ import annotations

import re

import numpy as np
import pytest

from docs.experiments.causes import ALIKE, catalogue_table, compared, likeness
from docs.experiments.causes_of_readings import COMPARED, TABLES
from docs.experiments.causes_of_readings import likeness as likeness_of_readings
from tests.conftest import PROJECT
from tests.docs.shown import shown
from truing.simulation.bench.causes.reading_causes import ReadingCause
from truing.simulation.catalogue import OWN_CAUSES, OWN_CAUSES_OF_READINGS
from truing.simulation.mechanisms.point_causes import PointCause

PAGE = (PROJECT / "docs" / "causes.md").read_text(encoding="utf-8")


def test_the_catalogue_is_that_of_the_code() -> None:
    assert shown(PAGE, "catalogue") == catalogue_table()


@pytest.mark.parametrize(
    ("heading", "causes"),
    [("## Cause by cause\n", OWN_CAUSES), ("### Cause by cause, on the bench\n", OWN_CAUSES_OF_READINGS)],
)
def test_every_cause_has_its_row(heading: str, causes: tuple[PointCause | ReadingCause, ...]) -> None:
    rows = re.findall(r"^\| `(\S+)` \|", PAGE.split(heading)[1].split("\n#")[0], re.M)
    assert rows == [cause.id for cause in causes]


@pytest.mark.parametrize(("name", "bare"), [("likeness", False), ("likeness-bare", True)])
def test_likeness_of_causes_on_the_page_is_the_computed_one(name: str, bare: bool) -> None:
    """To one per cent, and so is what is reported as alike."""
    rows = shown(PAGE, name).splitlines()[2:]
    cells = [[cell.strip() for cell in row.strip("|").split("|")[1:]] for row in rows]
    strong, found = likeness(bare).signal, likeness(bare).left
    assert [float(row.pop(0)) for row in cells] == pytest.approx(list(strong), rel=0.06)
    assert len(cells) == len(compared())
    for n, row in enumerate(cells):
        for k, cell in enumerate(row):
            if n == k:
                assert cell == ""
            else:
                assert float(cell.strip("*")) / 100 == pytest.approx(found[n, k], abs=0.011)
                assert cell.startswith("**") == (found[n, k] < ALIKE) or abs(found[n, k] - ALIKE) < 0.005


def test_a_gain_is_distinguished_from_a_deformation_by_targets_on_the_attachments_alone() -> None:
    names = [cause.id for cause in compared()]
    pair = names.index("actuator-gain"), names.index("platform-deformation-linear")
    assert likeness(bare=False).left[pair] > 0.5
    assert likeness(bare=True).left[pair] < 0.01


def test_every_cause_is_fully_confounded_with_itself() -> None:
    assert np.abs(np.diag(likeness(bare=True).left)).max() < 1e-6


def test_the_catalogue_of_a_bench_is_that_of_the_code() -> None:
    assert shown(PAGE, "catalogue-of-readings") == TABLES["catalogue-of-readings"]()


@pytest.mark.parametrize(("name", "own"), [("likeness-of-readings", False), ("likeness-of-own-channels", True)])
def test_likeness_of_bench_causes_on_the_page_is_the_computed_one(name: str, own: bool) -> None:
    """To one per cent; what does not show at all is like nothing."""
    rows = shown(PAGE, name).splitlines()[2:]
    cells = [[cell.strip() for cell in row.strip("|").split("|")[1:]] for row in rows]
    found = likeness_of_readings(own=own)
    assert [float(row.pop(0)) for row in cells] == pytest.approx(list(found.signal), rel=0.5, abs=0.002)
    assert len(cells) == len(COMPARED)
    for n, row in enumerate(cells):
        for k, cell in enumerate(row):
            if n != k and cell != "–":
                assert float(cell.strip("*")) / 100 == pytest.approx(found.left[n, k], abs=0.011)
            elif n != k:
                assert found.signal[n] < 0.001


def test_six_channels_distinguish_what_a_single_one_cannot() -> None:
    names = [cause.id for cause in COMPARED]
    scale, angle = names.index("stiffness-scale"), names.index("cosine-error")
    assert likeness_of_readings(own=False).left[scale, angle] > 0.9
    assert likeness_of_readings(own=True).left[scale, angle] < 0.01
