"""The bent flexure: reference values, the circle of its ends, and distances that satisfy its equation."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.simulation.mechanisms.flexure_telescope import STEP, vector
from tests.tolerance import assert_between, assert_close
from truing.simulation.mechanisms.structures.beam_model import (
    BendLaw,
    arc_distance,
    circle_distance,
    circle_remainder,
    deflection,
    flexure_path,
)

LENGTH_M = 0.01
DEGREES = ["0.6", "1.0"]


def arc_end(length: float, slope: float) -> tuple[float, float]:
    """Shortening and deflection of the end of an inextensible circular arc, m."""
    shortening = length * (1.0 - np.sinc(slope / np.pi))
    return float(shortening), float(length * slope / 2.0 * np.sinc(slope / (2.0 * np.pi)) ** 2)


@pytest.mark.parametrize("degrees", DEGREES)
def test_deflections_are_those_of_the_reference(degrees: str) -> None:
    inputs, outputs = vector(f"eq12.{degrees}")
    slope = np.deg2rad(inputs["delta_deg"])
    for law, prefix in ((deflection, ""), (arc_end, "arc_")):
        for found, name in zip(law(inputs["l_b_mm"] * 1e-3, slope), ("dx_mm", "dy_mm"), strict=True):
            expected = outputs[prefix + name]
            assert_close(found * 1e3, expected, atol=1e-9 * expected, what=prefix + name)


@pytest.mark.parametrize("degrees", DEGREES)
def test_ends_leave_the_circle_as_the_reference_says(degrees: str) -> None:
    inputs, outputs = vector(f"eq12.{degrees}")
    dx, dy = deflection(inputs["l_b_mm"], np.deg2rad(inputs["delta_deg"]))
    found = circle_remainder(inputs["l_b_mm"], dx, dy)
    assert_close(found, outputs["circle_residual_mm2"], atol=1e-12, what="square of mm, after cancellation")


def test_remainder_of_the_circle_is_of_fourth_order() -> None:
    slope = 0.05
    for law, share in ((deflection, 47 / 720), (arc_end, -1 / 720)):
        found = circle_remainder(1.0, *law(1.0, slope)) / slope**4
        assert_close(found, share, atol=slope**2, what="share of the fourth power")  # the next order is the sixth


def test_the_circle_is_harmless_at_one_degree() -> None:
    slope = np.deg2rad(1.0)
    radius_off = circle_remainder(1.0, *deflection(1.0, slope)) / (2 * 0.75)
    assert_between(float(radius_off), 3.5e-9, 4.5e-9, what="radius, flexure lengths")
    cosine = np.cos(slope)
    apart = circle_distance(np.array(1.0), cosine).value - arc_distance(np.array(1.0), cosine).value
    fourth = (1 / 432 + 1 / 80) * slope**4
    assert_close(apart, fourth, atol=slope**2 * fourth + 1e-15, what="circle less arc, flexure lengths")


@given(slope=st.floats(-0.7, 0.7))
def test_series_and_closed_forms_are_one_function(slope: float) -> None:
    dx, dy = deflection(1.0, slope)
    x = np.linspace(0.0, 1.0, 2001) * slope
    arc = np.sqrt(1 + x**2)
    simpson = (arc[0] + arc[-1] + 4 * arc[1::2].sum() + 2 * arc[2:-1:2].sum()) / 6000
    assert_close(dx, simpson - 1, atol=1e-14, what="dx")
    assert dy == slope / 2
    dx, dy = arc_end(1.0, slope)
    turned = np.array([1 - dx, dy]) * slope  # of a circle of radius 1 / slope
    assert_close(turned, [np.sin(slope), 1 - np.cos(slope)], atol=1e-15, what="end of the arc")


@pytest.mark.parametrize("degrees", DEGREES)
def test_distance_is_that_of_the_reference(degrees: str) -> None:
    inputs, outputs = vector(f"eq16.{degrees}")
    length = np.array(inputs["l_b_mm"] * 1e-3)
    found = circle_distance(length, np.array(inputs["cos"]), inputs["beta"]).value
    assert_close(found * 1e3, outputs["dl_mm"], atol=1e-9 * outputs["dl_mm"], what="dl, mm")
    longer_um = (found - length / 2) * 1e6
    assert_close(longer_um, outputs["change_um"], atol=1e-9 * outputs["dl_mm"] * 1e3, what="change, um")


@given(beta=st.floats(-1.0, 0.74), cosine=st.floats(0.5, 1.0))
def test_distance_is_the_positive_root_of_its_equation(beta: float, cosine: float) -> None:
    found = float(circle_distance(np.array(LENGTH_M), np.array(cosine), beta).value)
    square = found**2 + (1 - 2 * beta) * LENGTH_M * cosine * found + (beta - 0.75) * LENGTH_M**2
    assert found > 0
    assert_close(square, 0.0, atol=1e-14 * LENGTH_M**2, what="eq. 15, m2")


@given(beta=st.floats(-1.0, 0.74))
def test_a_straight_flexure_adds_half_its_length(beta: float) -> None:
    for law in (partial(circle_distance, beta=beta), arc_distance):
        found = law(np.array(LENGTH_M), np.array(1.0)).value
        assert_close(found, LENGTH_M / 2, atol=1e-15 * LENGTH_M, what="dl, m")


@given(slope=st.floats(0.0, 1.5))
def test_the_arc_s_distance_is_that_of_its_end_along_its_tangent(slope: float) -> None:
    dx, dy = arc_end(LENGTH_M, slope)
    along = (LENGTH_M / 2 - dx) * np.cos(slope) + dy * np.sin(slope)
    found = arc_distance(np.array(LENGTH_M), np.cos(slope)).value
    assert_close(found, along, atol=1e-14 * LENGTH_M, what="dl, m")


@pytest.mark.parametrize("law", [circle_distance, partial(circle_distance, beta=0.1), arc_distance])
@given(slope=st.floats(0.0, 1.5))
def test_derivatives_of_the_distance_agree_with_a_complex_step(law: BendLaw, slope: float) -> None:
    length, cosine = np.array(LENGTH_M), np.array(np.cos(slope))
    found = law(length, cosine)
    by_cosine = law(length, cosine + 1j * STEP).value.imag / STEP
    by_length = law(length + 1j * STEP, cosine).value.imag / STEP
    assert_close(found.by_cosine, by_cosine, atol=1e-13 * LENGTH_M, what="by cosine, m")
    assert_close(found.by_length, by_length, atol=1e-14, what="by length")


@given(beta=st.floats(-1.0, 0.7), slope=st.floats(0.0, 1.5))
def test_the_derivative_by_beta_agrees_with_a_complex_step(beta: float, slope: float) -> None:
    length, cosine = np.array(LENGTH_M), np.array(np.cos(slope))
    expected = circle_distance(length, cosine, np.array(beta + 1j * STEP)).value.imag / STEP
    assert_close(circle_distance(length, cosine, beta).by_beta, expected, atol=1e-12 * LENGTH_M, what="by beta, m")


def test_the_circle_follows_the_beam_and_the_ideal_pivot_does_not() -> None:
    """The report's figure 9: shortening l_b slope^2 / 6 of beam and circle, l_b slope^2 / 4 of a pivot."""
    slope = np.radians(np.linspace(0.1, 1.0, 10))
    path = flexure_path(LENGTH_M, slope)
    unit = LENGTH_M * slope**2
    assert_close(path.circle[0] / unit, path.beam[0] / unit, atol=1e-4, what="circle")
    assert_close(path.beam[0] / unit, np.full(10, 1 / 6), atol=1e-4, what="beam")
    assert_close(path.pivot[0] / unit, np.full(10, 1 / 4), atol=1e-4, what="pivot")
    assert_close(path.pivot[1], path.beam[1], atol=1e-4 * LENGTH_M * slope.max(), what="across")
