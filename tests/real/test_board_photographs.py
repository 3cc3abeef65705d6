"""Photographs of a chessboard by two cameras: calibration at least as accurate as published; skipped without the
data."""

from __future__ import annotations

import numpy as np
import pytest

from tests.real.board_photographs import BOARD, FOLDER, PAGE, PUBLISHED_BASE, PUBLISHED_RMS_PX, SIDES, Facts
from tests.real.campaigns import data_folder
from tests.tolerance import assert_between, assert_close

pytestmark = pytest.mark.skipif(
    not (data_folder() / FOLDER).is_dir(), reason=f"the photographs are not there: {data_folder() / FOLDER}"
)


@pytest.fixture(scope="module")
def facts():
    return Facts()


def test_every_board_is_seen_whole(facts):
    seen = {key: len(one.number) for key, one in facts.corners.items()}
    assert seen == dict.fromkeys(seen, BOARD.columns * BOARD.rows)


@pytest.mark.parametrize("side", SIDES)
def test_a_calibration_leaves_less_than_was_published(facts, side):
    assert facts.flat[side].adjustment.converged
    assert_between(facts.flat[side].rms_px[side], 0.0, PUBLISHED_RMS_PX[side], what="rms, px")


def test_the_base_line_is_the_same_from_both_halves_of_the_pairs(facts):
    whole, one, other = facts.together
    assert all(each.adjustment.converged for each in facts.together)
    # Mean and scatter of four pairs each: Student's t with six degrees of freedom, at one in a thousand.
    apart = abs(one.base[0] - other.base[0]) / np.hypot(one.base[1], other.base[1])
    assert_between(float(apart), 0.0, 5.96, what="difference of the halves over its sigma")
    assert_close(whole.base[0], PUBLISHED_BASE, atol=5.41 * whole.base[1])  # seven degrees of freedom


def test_the_page_holds_what_its_command_writes(facts):
    page = PAGE.read_text(encoding="utf-8")
    for name, make in facts.tables.items():
        reported = page.partition(f"<!-- table {name} -->\n")[2].partition("\n<!-- end -->")[0]
        # Decoders of JPEG round differently, by a grey level: sigma0 was 1.24 on one processor, 1.20 on another.
        assert numbers(reported) == pytest.approx(numbers(make()), rel=0.05, abs=0.003)


def numbers(text):
    return [float(cell) for line in text.splitlines()[2:] for cell in line.strip("| ").split(" | ")[1:] if cell.strip()]
