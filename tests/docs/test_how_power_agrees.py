"""The figures of docs/power.md are those of its comparison, and agree with the simulation."""

from __future__ import annotations

import re

import pytest

from benchmarks import power_agreement_page
from tests.blind.judging import UNLUCKY
from tests.blind.two_rates import Pair, unlike
from tests.docs.shown import shown
from tests.tolerance import assert_close

PAGE = power_agreement_page.PAGE.read_text(encoding="utf-8")
RECORDS = power_agreement_page.kept_records()
TABLES = power_agreement_page.tables(RECORDS)
NUMBER = re.compile(r"\d+(?:\.\d+)?")


@pytest.mark.parametrize("name", sorted(TABLES))
def test_each_table_is_that_of_the_results_that_are_kept(name: str) -> None:
    # Not to the last digit: libraries differ in that of a quantile.
    made, there = TABLES[name](), shown(PAGE, name)
    assert NUMBER.sub("number", made) == NUMBER.sub("number", there)
    assert_close([float(n) for n in NUMBER.findall(made)], [float(n) for n in NUMBER.findall(there)], atol=1.01)


def test_the_figure_is_that_of_the_results_that_are_kept() -> None:
    there = power_agreement_page.FIGURE.read_text(encoding="utf-8")
    assert NUMBER.sub("number", power_agreement_page.figure(RECORDS)) == NUMBER.sub("number", there)


@pytest.mark.parametrize("what", ["found", "named"])
def test_power_and_simulated_campaigns_find_equally_often(what: str) -> None:
    assert unlike(power_agreement_page.pairs(RECORDS, what)) > UNLUCKY


def test_pairs_are_counted_by_layout_sort_and_size() -> None:
    sort = {"layout": "few", "cause": "actuator-gain", "concerns": "one leg", "parameter": "gain"}
    answers = [(1.0, True, False), (1.0, True, True), (2.0, False, True)]
    made = [{**sort, "factor": f, "power": {"found": a}, "generator": {"found": b}} for f, a, b in answers]
    assert power_agreement_page.pairs(made) == [Pair(2, 2, 1, 2), Pair(0, 1, 1, 1)]
