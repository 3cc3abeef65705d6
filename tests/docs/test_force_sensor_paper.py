"""docs/force-sensor-paper.md: its numbers are computed by the code, and its statements hold."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from docs.experiments import force_sensor_deformation as deformation
from docs.experiments import force_sensor_figures, force_sensor_paper
from docs.experiments import force_sensor_statics as statics
from docs.experiments import force_sensor_tolerances as tolerances
from docs.experiments.force_sensor_sets import ARCSEC, LENS_M, SETS, UNITS, published, sigmas, three_fold
from tests.docs.shown import shown
from tests.simulation.bench.six_upur.sensors import REFERENCE, joints_of, sensor_of
from tests.tolerance import assert_between, assert_close
from truing.simulation.bench.six_upur.assembly import closed_loop_map
from truing.simulation.bench.six_upur.influence import force_bound, influence_matrix, merit
from truing.simulation.bench.six_upur.loading import eccentric_wrench

PAGE = force_sensor_paper.PAGE.read_text(encoding="utf-8")
SLOW = ("sampling", "ranking", "table-2")  # sampled below


@pytest.mark.parametrize("name", [name for name in force_sensor_paper.TABLES if name not in SLOW])
def test_the_page_shows_what_the_command_writes(name: str) -> None:
    old_ones, made = (_numbers(text) for text in (shown(PAGE, name), force_sensor_paper.TABLES[name]()))
    assert len(old_ones) == len(made)
    for (old, digit), (new, _) in zip(old_ones, made, strict=True):
        assert new == pytest.approx(old, rel=1e-6, abs=1.01 * digit)


def _numbers(text: str) -> list[tuple[float, float]]:
    """Numbers of a table, each with what its last digit is worth; what is zero but for rounding counts as zero."""
    text = re.sub(r"[\d.]+e-1\d", "0", text.replace(",", ""))
    words = list(re.finditer(r"(?<![\w.])[-+−]?\d+(?:\.(\d+))?", text))
    assert words
    return [(float(w.group().replace("−", "-")), float(f"1e-{len(w[1] or '')}")) for w in words]


def test_all_marks_of_the_page_have_a_table() -> None:
    assert sorted(re.findall(r"<!-- table (\S+) -->", PAGE)) == sorted(force_sensor_paper.TABLES)


@pytest.mark.parametrize("name", list(SETS))
def test_the_sets_are_those_of_the_reference(name: str) -> None:
    """The reference gives polar angles to 1e-4 degrees, and the joints that follow from them."""
    found, expected = SETS[name].joints(), joints_of(name)
    assert_close(found.lower, expected.lower, atol=1e-15, what="B")
    assert_close(found.arm, expected.arm, atol=1e-15, what="b")
    assert_close(SETS[name].sensor().compliance * 1e9, sensor_of(name).compliance * 1e9, atol=1e-9, what="compliance")
    assert REFERENCE["sets"][f"fs_{name}"]["flexure"]["t"] == SETS[name].thickness


def test_the_printed_J_belongs_to_no_six_legs_and_the_others_might() -> None:
    print_ = published().table4
    assert force_bound(np.array(print_.J)) > 3 * 6.0
    assert min(print_.J) < 1 / np.sqrt(6)
    assert force_bound(np.array(print_.J_prime)) < 6.0
    assert force_bound(np.array(print_.J_B_prime)) < 6.0


def test_both_twists_and_no_other_give_the_printed_condition() -> None:
    found = statics.twists_of(published().condition.G)
    assert len(found) == 2
    for twist, expected in zip(found, (9.00863, 85.75955), strict=True):
        assert_between(twist, expected - 2e-5, expected + 2e-5, what="twist")
        for half in (0.0, 33.0):
            turned = merit(influence_matrix(three_fold(half, half + twist).joints())).condition
            assert_close(turned, published().condition.G, atol=1e-9, what="condition at another half angle")


def test_largest_errors_change_G_by_less_than_a_percent() -> None:
    for each in SETS.values():
        plain = merit(influence_matrix(each.joints()))
        for displaced in statics.with_errors(each.joints()):
            found = merit(displaced)
            assert np.abs(found.condition / plain.condition - 1).max() < 0.01
            assert np.abs(found.sensitivity / plain.sensitivity - 1).max() < 0.01


def test_sources_that_are_alike_have_the_ratio_of_their_tolerances() -> None:
    for twist in (9.0, 40.0, 85.8):
        scaled = closed_loop_map(three_fold(20.0, 20.0 + twist).joints()) * sigmas()
        rms = np.sqrt(np.sum(scaled[:3] ** 2, (0, 1)))
        assert_close(rms[0] / rms[1], 155 / 130, atol=1e-12, what="REM over REF")
        assert_close(rms[2] / rms[3], 1.0, atol=1e-12, what="ECP over ECU")


def test_a_hundred_samples_are_worth_what_the_page_says() -> None:
    means = tolerances.experiment_means("twist 9.0°")
    low, high = np.quantile(means[:, 0, 3] / means[:, 0, 2], [0.025, 0.975])
    written = re.findall(r"twist 9.0° \| position \| (\d+) % \| ([\d.]+) to ([\d.]+)", shown(PAGE, "ranking"))[0]
    assert_close([low, high], [float(each) for each in written[1:]], atol=0.006, what="ECU over ECP")
    assert_close(100 * tolerances.right_order(means[:, 0]), float(written[0]), atol=0.6, what="right order")


def test_the_sampled_table_is_one_of_the_sources_on_the_page() -> None:
    rows = [line for line in shown(PAGE, "sampling").splitlines() if "µm" in line and line.startswith("| ")]
    assert len(rows) == 5
    for line in rows:
        first, few, many = (float(x) for x in re.findall(r"\| ([\d.]+)(?: \(|(?= \|))", line)[:3])
        assert abs(many / first - 1) < 0.01
        assert abs(few / first - 1) < 4 * 0.055


def test_no_three_fold_sensor_of_the_printed_size_meets_table_2() -> None:
    row = re.findall(r"three-fold, best \| (.*) \|", shown(PAGE, "table-2"))[0]
    found = np.array([float(cell) for cell in row.split("|")][:6])
    misfit = np.sqrt(np.mean(np.log(found / published().table2.values) ** 2))
    assert misfit > 0.2
    best = deformation.per_1000(three_fold(20.0, 110.0).sensor())
    assert_close(best[0], best[1], atol=1e-9 * best[0], what="C_Fx and C_Fy")
    assert_close(best[3], best[4], atol=1e-9 * best[3], what="C_Mx and C_My")


def test_an_offset_has_no_even_part_and_the_two_units_have_the_measured_one() -> None:
    sensor = SETS["A"].sensor()
    odd, even = deformation.parts_along_z()
    loads = np.array([deformation.FULL, -deformation.FULL])
    units = deformation.units_at_rim(sensor, odd, even)
    moved = sensor.displacement(units.wrench(loads))
    seen = 1e6 * (moved[:, 2] - LENS_M * moved[:, 4])
    assert_close(seen, [428.21, -206.99], atol=1e-9, what="seen by the lens, um")
    for offset in np.random.default_rng(0).normal(0.0, 1.0, (5, 3)):
        off = sensor.displacement(eccentric_wrench("fz", loads, offset))
        assert_close(off.sum(0), np.zeros(6), atol=1e-15, what="even part of an offset")
    assert np.abs(moved[:, 4]).max() / ARCSEC < 100, "a tilt that a bench can have"


def test_table_2_times_nine_is_the_theory_of_fy_alone() -> None:
    ratio = np.array(published().maxima.theory) / (9 * np.array(published().table2.values))
    assert np.flatnonzero(np.abs(ratio - 1) < 0.01).tolist() == [1]
    assert UNITS[0] == 1e6


@pytest.mark.parametrize(("name", "kind"), list(force_sensor_paper.FIGURES.items()))
def test_figures_are_complete_svg_files(tmp_path: Path, name: str, kind: int) -> None:
    force_sensor_figures.draw(tmp_path / name, kind)
    text = (tmp_path / name).read_text(encoding="utf-8")
    assert "nan" not in text
    assert text.count("<circle") == 3 * 5 * 100 + 1
    committed = force_sensor_paper.DOCS / "figures" / name
    assert committed.read_text(encoding="utf-8").count("<circle") == text.count("<circle")
