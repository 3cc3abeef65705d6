"""Statements of docs/calibration.md hold, and its tables are those of its command."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from docs.experiments import calibration
from tests.docs.shown import shown

PAGE = (Path(calibration.__file__).resolve().parents[1] / "calibration.md").read_text(encoding="utf-8")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


@pytest.fixture(scope="module", autouse=True)
def shared_run(sample_run: Path) -> Iterator[None]:
    """Tables are made of the run that all tests share."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "run_folder", lambda: sample_run)
        yield


@pytest.mark.parametrize("name", ["models", "departures", "kappa"])
def test_the_tables_of_the_sample_are_what_the_command_writes(name):
    made = calibration.TABLES[name]()
    page = shown(PAGE, name)
    assert NUMBER.sub("#", page) == NUMBER.sub("#", made)
    for old, new in zip(NUMBER.findall(page), NUMBER.findall(made), strict=True):
        digits = len(old.partition(".")[2])
        assert float(old) == pytest.approx(float(new), abs=1.01 * 10.0**-digits)  # one unit of the last digit shown


def test_errors_in_variables_gain_what_the_page_says():
    scenario = {entry.words: entry for entry in calibration.SCENARIOS}
    lines = shown(PAGE, "estimators").splitlines()[2:]
    assert [line.split("|")[1].strip() for line in lines] == list(scenario)
    for line in lines:
        likely, implicit = map(float, NUMBER.findall(line.split("|")[2]))
        assert likely < implicit
    # A dozen draws of the first and the last row: rms of so few scatter by a quarter, bad poses cost a factor of ten.
    clean, bad = (calibration.rms_errors(calibration.SCENARIOS[i], 12) for i in (0, 3))
    assert clean[0, 2] < clean[1, 2]
    assert bad[1, 0] > 4 * bad[0, 0]
