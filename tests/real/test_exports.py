"""Real exports are recognised and read, and agree with their own reports."""

from __future__ import annotations

import numpy as np
import pytest

from tests.formats.reading import read
from tests.tolerance import assert_close
from truing.formats.sniff import sniff_file


def proposed(path, **reported):
    """A real file, read as it is proposed to be, where its body and pose are the only words of a person."""
    guess = sniff_file(path)
    entry = {key: value for key, value in guess.mapping.items() if key != "constants"}
    found = read(path.parent, entries={"path": path.name, **entry, "constants": {"body": "b", **reported}})
    assert found.faults == ()
    return guess, found


def test_the_points_of_an_adjustment_are_those_that_its_report_counts(real_data):
    """AICON: 150 estimated points, and the rms of their standard deviations as printed, mm."""
    guess, found = proposed(real_data / "aicon-bundle" / "example.obc", pose=1)
    assert guess.mapping["format"] == "aicon"
    assert len(found.rows) == 150
    sigma = np.array([found.columns[f"sigma_{axis}_mm"] for axis in "xyz"])
    rounding = 1e-4 / np.sqrt(12 * 150)  # one sigma of a mean over 150 numbers with four decimals
    assert_close(np.sqrt(np.mean(sigma**2, axis=1)), [0.003180, 0.003678, 0.003098], atol=3 * rounding)
    scale = {row["target"]: np.array([row[f"{axis}_mm"] for axis in "xyz"]) for row in found.rows}
    assert np.linalg.norm(scale["506"] - scale["507"]) == pytest.approx(1389.6880, abs=2e-4)


def test_every_bundle_of_a_telescope_is_known(real_data):
    paths = sorted((real_data / "so-lat-telescope" / "vstars").glob("*.csv"))
    assert len(paths) == 26
    assert {sniff_file(path).mapping.get("format") for path in paths} == {"vstars"}
    _, found = proposed(paths[0], pose=1)
    assert all(0.0 < sigma < 10.0 for sigma in found.columns["sigma_x_mm"])


def test_every_target_list_of_a_tracker_is_known(real_data):
    paths = sorted((real_data / "so-lat-telescope" / "tracker-elevation-20250610").glob("LATR_*_step_*.txt"))
    assert len(paths) == 4
    for path in paths:
        guess, found = proposed(path, target="T")
        assert guess.mapping["format"] == "tracker"
        assert len(found.rows) == 19
