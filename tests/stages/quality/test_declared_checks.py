"""Quality checks follow their declarations: names, limits, and rows of qa.parquet."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import PROJECT
from truing.formats.guess import Guess
from truing.pipeline.init_entries import RawGroup
from truing.pipeline.init_text import campaign_text
from truing.report.belonging import RELATIONS
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.schemas.quality_checks import CHECKS, settable
from truing.schemas.sections import SetLimits
from truing.stages.quality.check import CampaignLimits

# What others may rely on: names are added here, never taken out or renamed.
# fmt: off
STABLE_POINTS = (
    "unobserved-poses", "attachment-labels", "completeness", "poses-determined", "geometry", "geometry-line",
    "geometry-plane", "geometry-leverage", "gross-errors", "exchanged-labels", "moved-targets", "noise",
    "noise-by-pose", "base-drift", "overruled", "repeatability", "time-gaps", "temperature-span",
    "points-against-survey", "copied-poses", "legs-regular", "readings-against-poses",
)
STABLE_LOADS = (
    "overruled", "steps-missing", "runs-cut-short", "completeness", "time-gaps", "load-range", "units", "signs",
    "channels-exchanged", "run-zeros", "gross-errors", "noise", "jumps", "drift", "zero-return", "repeatability",
    "surroundings", "temperature-span", "pressure-span", "worth-of-air", "corrections", "signals", "saturated",
    "loads-span", "signals-independent", "exchanged-rows", "signals-round", "fringes-counted",
)
# fmt: on
STABLE_COLUMNS = ["check", "subject", "value", "limit", "unit", "verdict", "message", "accepted"]
# Where a check's name stands in what makes a row of it.
PLACE_OF_NAME = {"Check": 0, "not_evaluated": 1, "of": 0}


def names_in(path: Path) -> Iterator[str | None]:
    """The names of the checks that a module makes rows of; None of one that it does not spell out."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if called in PLACE_OF_NAME:
            name = node.args[PLACE_OF_NAME[called]]
            yield name.value if isinstance(name, ast.Constant) else None


def test_every_check_that_the_code_makes_is_declared_and_the_other_way_round():
    others = ("check.py", "belonging.py")  # of which the last makes one row of each relation
    modules = [p for p in (PROJECT / "stages" / "quality").glob("*.py") if p.name not in others]
    assert {name for path in modules for name in names_in(path)} | set(RELATIONS) == {
        *CHECKS["photogrammetry"],
        *CHECKS["interferometer"],
    }


def test_names_and_columns_stay():
    assert set(STABLE_POINTS) <= set(CHECKS["photogrammetry"])
    assert set(STABLE_LOADS) <= set(CHECKS["interferometer"])
    assert ARTIFACTS["qa"].arrow_schema(present=("accepted",)).names[: len(STABLE_COLUMNS)] == STABLE_COLUMNS


def read(kind: str, **limits: dict[str, object]) -> object:
    checks = {name.replace("_", "-"): own for name, own in limits.items()}
    return read_campaign({"campaign": {"name": "x", "kind": kind}, "qa": {"limits": checks}})


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({"completness": {"warn": 0.1}}, "key qa.limits.completness: expected a check whose .* mean completeness"),
        ({"load_range": {"warn": 0.1}}, "qa.limits.load-range: expected a check of a campaign of kind photogrammetry"),
        ({"noise": {"fail": 2.0}}, r"limits.noise: expected a check with a settable limit; .* \(\[qa\] false_alarm\)"),
        ({"completeness": {"warn": 0.4}}, r"expected fail \(0.3\) at least warn \(0.4\).* has its default"),
        (
            {"completeness": {"warn": 0.2, "fail": 0.1}},
            r"fail \(0.1\) at least warn \(0.2\), because a failure is worse than a warning$",
        ),
        ({"geometry_line": {"warn": 3.0}}, r"expected fail \(5\) at most warn \(3\)"),
        (
            {"gross_errors": {"fail": 30.0}},
            r"gross-errors.fail: found '30'; expected at most 1 \(share of",
        ),
        ({"time_gaps": {"warn": -1.0}}, "qa.limits.time-gaps.warn: found '-1.0'; expected at least 0"),
        ({"time_gaps": {"worn": 1.0}}, "qa.limits.time-gaps.worn: expected a known key; did you mean warn"),
        ({"time_gaps": {"reason": "why not"}}, "qa.limits.time-gaps: expected warn, fail, or both"),
    ],
)
def test_limits_that_mean_nothing_are_faults(limits, expected):
    with pytest.raises(CampaignFaults, match=expected):
        read("photogrammetry", **limits)


@pytest.mark.parametrize("kind", CHECKS)
def test_the_declared_limits_are_in_the_template_and_may_be_set(kind):
    table = {"photogrammetry": "points", "interferometer": "signals"}[kind]
    text = init_text(table)
    for name, limits in settable(kind).items():
        line = next(line for line in text.splitlines() if line.startswith(f"#   {name} "))
        assert all(words in line for words in (limits.of, limits.warns, limits.fails))
        read(kind, **{name: {"warn": limits.warn, "fail": limits.fail}})


def init_text(table: str) -> str:
    name = f"{table}.csv"
    return campaign_text("x", [(RawGroup(name, Path(name), 1), Guess(table=table))])


@pytest.mark.parametrize(
    ("value", "verdict", "limit"), [(0.05, "pass", 0.1), (0.1, "pass", 0.1), (0.2, "warn", 0.1), (0.4, "fail", 0.3)]
)
def test_a_row_gives_the_limit_that_its_verdict_rests_on(value, verdict, limit):
    row = CampaignLimits("photogrammetry").of("completeness").row("base", value, "1", "said.")
    assert (row.verdict, row.limit, row.message) == (verdict, limit, "said.")


def test_limits_are_held_in_the_unit_of_the_value_and_on_their_side():
    line = CampaignLimits("photogrammetry", {"geometry-line": SetLimits(warn=8.0)}).of("geometry-line", per=0.5)
    assert [line.verdict(value) for value in (5.0, 4.0, 3.0, 2.5, 2.0)] == ["pass", "pass", "warn", "warn", "fail"]
    assert line.row("base", 3.0, "mm", "").limit == 4.0
    assert line.row("base", 3.0, "mm", "", counts=False).verdict == "pass"
