"""Causes with subjects and parameters in a sentence, without repeated words."""

from __future__ import annotations

import re

import pytest

from truing.report.error_figures import error_figure_words
from truing.report.wordings.catalogue import (
    WORDINGS,
    cause_meaning,
    cause_words,
    noun_of_subject,
    parameter_of_cause,
)

SUBJECTS = (
    "joint elbow",
    "leg3",
    "leg1 leg4",
    "joint a joint b",
    "link forearm",
    "axis",
    "base",
    "target P07",
    "column",
)


@pytest.mark.parametrize("cause", WORDINGS)
@pytest.mark.parametrize("subject", SUBJECTS)
def test_the_kind_of_the_subject_is_named_once(cause: str, subject: str) -> None:
    words = noun_of_subject(cause_words(cause), subject)
    kind = subject.rstrip("0123456789").split()[0].rstrip("0123456789")
    of_kind = re.fullmatch(rf".* of (an? |the )?{kind}s?", cause_words(cause))
    assert len(re.findall(rf"\b{kind}s?\b", words)) == 1 or not of_kind


@pytest.mark.parametrize(
    ("parameter", "cause", "subject", "words"),
    [
        ("compliance", "joint-compliance", "joint shoulder", "compliance of joint shoulder"),
        ("gain", "joint-gain", "joint elbow", "gain of joint elbow"),
        ("drift", "leg-drift", "leg3", "drift of leg 3"),
        ("drift", "base-drift", "base", "drift of base"),
        ("fraction", "creep", "load fz", "fraction (creep, load fz)"),
        ("amplitude", "periodic-error", "axis", "amplitude (periodic error, axis)"),
        ("sag", "joint-sag", "joint a joint b", "sag of joints a and b"),
        ("gain", "actuator-gain", "leg3", "actuator gain (leg 3)"),
        ("scale", "measurement-scale", "", "measurement scale"),
    ],
)
def test_a_parameter_named_like_its_cause_is_named_once(parameter: str, cause: str, subject: str, words: str) -> None:
    assert parameter_of_cause(parameter, cause, subject) == words


def test_the_platform_deforms_in_its_plane_with_each_legs_own_actuator() -> None:
    assert "at each leg with its own actuator" in cause_meaning("in-plane-deformation")


@pytest.mark.parametrize(
    ("figure", "words"),
    [
        ("rms_error", "rms error"),
        ("verification_max_error", "largest error, held-out data"),
        ("cv_mean_error", "mean absolute error, each pose or run predicted from the others"),
        ("figure_of_a_package", "figure of a package"),
    ],
)
def test_statistics_of_deformation_models_are_named_in_words(figure: str, words: str) -> None:
    assert error_figure_words(figure) == words
