"""Reported source and check of the scale of photographs; distances of a survey are reported by body."""

from __future__ import annotations

from typing import Any

import pyarrow as pa
import pytest

from tests.sentences import assert_says
from truing.stages.quality.check import CampaignLimits, Check
from truing.stages.quality.scale_checks import Figures, bar_lengths, figures_of, scale, target_sizes

LIMITS = CampaignLimits("photogrammetry")
SURVEY = [("survey, a/1 to a/2", "a/1"), ("survey, a/3 to a/4", "a/3"), ("survey, b/1 to b/2", "b/1")]


def figures(*rows: tuple[str, str, float]) -> Figures:
    names = ("figure", "subject", "value")
    return figures_of(pa.table({name: [row[k] for row in rows] for k, name in enumerate(names)}))


def lengths(bars: list[tuple[str, str]], serves: str = "scale", off_um: float = 0.0) -> pa.Table:
    """Bars in two poses, a sigma of 10 um; the last is off in the second."""
    rows: list[dict[str, Any]] = [
        {"pose": pose, "bar": bar, "first": first, "serves": serves, "length_mm": 500.0, "sigma_mm": 0.01}
        | {"adjusted_mm": 500.0, "adjusted_sigma_mm": 0.01, "deviation_mm": 0.0, "deviation_sigma_mm": 0.01}
        for pose in (1, 2)
        for bar, first in bars
    ]
    rows[-1]["deviation_mm"] = 1e-3 * off_um
    return pa.Table.from_pylist(rows)


def scale_check(*bars: pa.Table, surveyed: bool = False, known: tuple[tuple[str, str, float], ...] = ()) -> Check:
    reported = figures(("scale from scale bars", "pose 1", 1.0), ("scale from scale bars", "pose 2", 1.0), *known)
    (check,) = scale(reported, pa.concat_tables(bars), surveyed=surveyed)
    return check


def test_a_scale_that_nothing_checks_is_reported_as_such() -> None:
    for bars, what in ((SURVEY, "3 distances of the survey"), ([("S", "s/1")], "scale bar S")):
        message = scale_check(lengths(bars), surveyed=bars is SURVEY).message
        assert_says(message, "2 poses", "scale", f"{what} alone")
        assert_says(message, "Nothing checks")


@pytest.mark.parametrize(
    ("check", "words"),
    [
        (scale_check(lengths([("S", "s"), ("T", "t")])), "from scale bars S, T, checked by each other."),
        (scale_check(lengths([("S", "s")]), surveyed=True), "from scale bar S, checked by the survey."),
        (
            scale_check(lengths([("S", "s")]), lengths([("C", "c")], "check")),
            "from scale bar S, checked by reference length C.",
        ),
        (
            scale_check(lengths(SURVEY), surveyed=True, known=(("size over stated", "circles", 1.01),)),
            "from 3 distances of the survey, checked by the width of circles.",
        ),
    ],
)
def test_a_passed_scale_check_names_what_it_was_compared_with(check: Check, words: str) -> None:
    assert check.message.endswith(words)
    assert check.verdict == "pass"


def _compared(sigma: float = 6e-6, noise: float = 1.0, **ratio: float) -> Check:
    """The check of lengths over those of the rays, by name, with their sigma."""
    known = [("lengths over those of the rays", name.replace("_", " "), value) for name, value in ratio.items()]
    known += [("lengths over those of the rays, sigma", name, sigma) for _, name, _ in known]
    return scale_check(lengths([("A", "a"), ("B", "b")]), known=(*known, ("noise over stated", "circle", noise)))


def test_a_contradiction_next_to_noisy_rays_is_not_blamed_on_the_lengths_alone() -> None:
    lens = {"bar_A": 1.0002, "bar_B": 0.9998, "survey_of_base": 0.9965}
    assert_says(_compared(**lens, noise=5.9).message, "noise of image coordinates", "5.9 times", "distortion")
    assert "distortion" not in _compared(**lens).message


def test_sizes_show_another_unit() -> None:
    assert [check.verdict for check in target_sizes(figures(), LIMITS)] == ["not evaluated"]
    reported = figures(("size over stated", "circles", 1.04), ("size over stated", "markers", 1 / 25.4))
    circles, markers = target_sizes(reported, LIMITS)
    assert (circles.verdict, markers.verdict) == ("pass", "fail")
    assert markers.value == pytest.approx(25.4)
    assert "0.0394 times" in markers.message


def test_distances_of_the_survey_are_one_row_a_body() -> None:
    table = pa.concat_tables(
        [lengths([("S", "s/1")]), lengths(SURVEY, off_um=-70.0), lengths([("marker, m.0 to m.2", "m.0")])]
    )
    rows = {check.subject: check for check in bar_lengths(table, LIMITS) if check.check == "bar-lengths"}
    assert list(rows) == ["bar S", "survey of a", "survey of b", "markers and boards"]
    assert [check.verdict for check in rows.values()] == ["pass", "pass", "warn", "pass"]
    assert_says(rows["survey of a"].message, "2 distances", "2 poses", "0 of 4", "limit")
    assert_says(rows["survey of b"].message, "1 of 2", "limit", "b/1 to b/2", "-70.0 ± 10.0 um")
