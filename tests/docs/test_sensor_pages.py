"""Tables of the pages on calibration and errors of force sensors are those of their commands."""

from __future__ import annotations

import re

import numpy as np
import pytest

from docs.experiments import sensor_bench, sensor_calibration, sensor_errors
from tests.docs.shown import shown
from tests.tolerance import assert_close

NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
CALIBRATION, ERRORS = (module.PAGE.read_text(encoding="utf-8") for module in (sensor_calibration, sensor_errors))


def _cells(page: str, name: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in shown(page, name).splitlines()[2:]]


@pytest.mark.parametrize(
    ("page", "module", "name"),
    [(CALIBRATION, sensor_calibration, name) for name in ("missing", "heart", "loading")]
    + [(ERRORS, sensor_errors, name) for name in ("planted", "types")],
)
def test_tables_are_what_the_command_writes(page, module, name):
    old, new = shown(page, name), module.TABLES[name]()
    assert NUMBER.sub("#", old) == NUMBER.sub("#", new)
    for left, right in zip(NUMBER.findall(old), NUMBER.findall(new), strict=True):
        digits = len(left.partition(".")[2])
        assert float(left) == pytest.approx(float(right), abs=1.01 * 10.0**-digits)  # one unit of the last digit shown


def test_the_bench_has_the_condition_number_that_the_page_says():
    assert np.linalg.cond(sensor_bench.influence()) == pytest.approx(6.3336, abs=5e-5)
    assert_close(sensor_bench.CELL_N_PER_MV, 980.665, atol=1e-9)
    loads, run = sensor_bench.single_axis()
    assert loads.shape == (120, 6)
    assert len(np.unique(run)) == 12


def test_errors_in_both_gain_where_the_page_says_so():
    lines = _cells(CALIBRATION, "estimators")
    assert [line[0] for line in lines] == list(sensor_calibration.SCENARIOS)
    reported = [[float(x) for cell in line[1:] for x in NUMBER.findall(cell)] for line in lines]
    for plain, plain_pull, _, weighted_pull, both, both_pull in reported:
        assert both <= plain
        assert 0.85 < both_pull < 1.15
        assert plain_pull < 1.3 < weighted_pull
    noisy = sensor_calibration.estimator_errors("signals to 0.2 mV", 6)
    assert noisy["errors in both"][0] < noisy["least squares, as printed"][0]
    assert noisy["weighted"][1] > 10


def test_eight_channels_determine_the_matrix_only_forwards():
    lines = {line[0]: [float(x) for x in line[1:]] for line in _cells(CALIBRATION, "channels")}
    assert list(lines) == list(sensor_calibration.CHANNELS)
    inverted, forward = (lines[name] for name in list(lines)[-3::2])
    assert 15 < inverted[1] / forward[1] < 25  # "twenty times"
    assert inverted[0] < 1.05 * forward[0]  # "nearly as well"
    few = [sensor_calibration.channel_errors(name, 5)[1] for name in list(lines)[-3::2]]
    assert few[0] > 10 * few[1]


def test_sigmas_by_cases_stay_honest_where_runs_share_an_error():
    reported = [[float(x) for x in line[1:]] for line in _cells(CALIBRATION, "shared")]
    assert len(reported) == len(sensor_calibration.SHARED)
    assert all(0.8 < by_case < 1.2 for _, by_case in reported)
    assert reported[0][0] < 1.1 < 1.7 < reported[-1][0]
    assert sensor_calibration.shared_pulls(5e-3, 2)[0] > 1.4


def test_the_model_that_is_there_is_chosen():
    lines = _cells(CALIBRATION, "choice")
    assert [line[0] for line in lines] == list(sensor_calibration.TRUTHS)
    counts = np.array([[int(cell) for cell in line[1:]] for line in lines])
    assert np.all(counts.sum(1) == sensor_calibration.DRAWS // 4)
    assert np.all(counts[[0, 1, 2, 4], [0, 1, 2, 3]] >= 9)
    assert counts[3, 1] >= 8  # a bend below the noise is left alone
    assert sensor_calibration.chosen("a zero, and a bend of 0.02 mV", 1)[3] == 1


def test_exchanged_rows_are_named_from_two_per_cent_on():
    lines = _cells(CALIBRATION, "rows")
    assert all(line[3] == "0" for line in lines)
    assert [int(line[2]) for line in lines[-2:]] == [sensor_calibration.DRAWS] * 2
    assert sensor_calibration.exchanged(0.02, 5) == (5, 0)
    assert sensor_calibration.exchanged(0.0, 5) == (0, 0)


def test_every_planted_error_is_found_within_its_uncertainty():
    for line in _cells(ERRORS, "planted"):
        true, limit = float(line[2]), float(line[4])
        value, sigma = map(float, line[3].split("±"))
        assert abs(value - true) < 3 * sigma + limit / 3  # the largest of several is biased upwards
        assert value > limit


def test_noise_alone_exceeds_limits_as_seldom_as_they_promise():
    shares = [float(line[1].split()[0]) for line in _cells(ERRORS, "silent")]
    assert len(shares) == 6
    assert max(shares) < 5.0 + 3 * 0.69  # three sigmas of 5 % in 1000
    assert set(sensor_errors.exceeded(3)) == {line[0] for line in _cells(ERRORS, "silent")}
