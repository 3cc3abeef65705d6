"""Compliance of flexible parts: reference values, textbook formulas, and symmetry and definiteness."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.simulation.bench.six_upur.sensors import SEEDS, vector
from tests.tolerance import assert_between, assert_close
from truing.simulation.bench.six_upur.elements import (
    cylinder_compliance,
    leaf_compliance,
    moved_along,
    notch_compliance,
    rectangle_torsion,
    transport,
    universal_joint,
)
from truing.simulation.mechanisms.structures.beams import element_stiffness, section

WEBS = st.floats(1e-4, 1e-2)
RADII = st.floats(1e-4, 2e-2)
E_PA, NU = 206e9, 0.3
# The reference has the leaf along x and soft about z; here it is along z, and soft about x.
FROM_REFERENCE = [1, 2, 0, 4, 5, 3]


def test_a_leaf_about_its_centre_is_that_of_the_reference() -> None:
    inputs, outputs = vector("leaf")
    found = leaf_compliance(inputs["l"], inputs["w"], inputs["t"], inputs["E"], inputs["nu"], "s1")
    centred = moved_along(found, np.array(-0.5 * inputs["l"]))
    expected = np.array(outputs["C"])[np.ix_(FROM_REFERENCE, FROM_REFERENCE)]
    # the reference's third axis is soft: here the first, so that y of the leg is the reference's second
    turned = _quarter(expected)
    size = np.sqrt(np.diag(turned))
    assert_close(centred / np.outer(size, size), turned / np.outer(size, size), atol=1e-12, what="compliance")


def _quarter(matrix: NDArray) -> NDArray:
    """The same part turned a quarter about the leg."""
    turn = np.kron(np.eye(2), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    return turn @ matrix @ turn.T


@given(length=st.floats(0.01, 0.5), diameter=st.floats(1e-3, 3e-2))
def test_a_cylinder_is_the_beam_element_held_at_its_inner_end(length: float, diameter: float) -> None:
    """The element has its axis along x: x, y, z of it are z, x, y of the leg."""
    stiffness = element_stiffness(np.array(length), section(diameter, E_PA, NU))[6:, 6:]
    places = [1, 2, 0, 4, 5, 3]
    found = cylinder_compliance(length, diameter, E_PA, NU) @ stiffness[np.ix_(places, places)]
    assert_close(found, np.eye(6), atol=1e-12 * max(length, 1 / length), what="compliance times stiffness")


@given(web=WEBS, radius=RADII)
def test_a_notch_is_the_closed_form_of_the_literature(web: float, radius: float) -> None:
    """Wu and Zhou, Rev. Sci. Instrum. 73 (2002) 3101, with s = radius / web: rotation and stretch."""
    width, s = 0.013, radius / web
    root, angle = np.sqrt(4 * s + 1), np.arctan(np.sqrt(4 * s + 1))
    turn = 2 * s**3 * (6 * s**2 + 4 * s + 1) / ((2 * s + 1) * (4 * s + 1) ** 2)
    turn += 12 * s**4 * (2 * s + 1) * (4 * s + 1) ** -2.5 * angle
    turn *= 12 / (E_PA * width * radius**2)
    stretch = (2 * (2 * s + 1) / root * angle - np.pi / 2) / (E_PA * width)
    found = notch_compliance(width, web, radius, E_PA, NU, "s1")
    assert_close(found[3, 3] / turn, 1.0, atol=1e-11, what="rotation")
    assert_close(found[2, 2] / stretch, 1.0, atol=1e-11 * max(1.0, 1 / s), what="stretch")
    lever = 2 * radius
    assert_close(found[1, 3] / (-0.5 * lever * turn), 1.0, atol=1e-11, what="half way out it only turns")


@given(web=WEBS, radius=RADII, width=st.floats(1e-3, 3e-2))
def test_all_of_a_notch_is_its_slices_one_after_the_other(web: float, radius: float, width: float) -> None:
    """Independent of the substitution: many short leaves, each as thick as the notch where it is."""
    phi = np.linspace(-np.pi / 2, np.pi / 2, 4001)
    edge, middle = radius * np.sin(phi), 0.5 * (phi[1:] + phi[:-1])
    step, thick = np.diff(edge), web + 2 * radius * (1 - np.cos(middle))
    beyond = radius - 0.5 * (edge[1:] + edge[:-1])
    shear = E_PA / (2 * (1 + NU))
    slices = np.zeros((len(step), 6, 6))
    for place, share in (
        (2, step / (E_PA * width * thick)),
        (3, 12 * step / (E_PA * width * thick**3)),
        (4, 12 * step / (E_PA * width**3 * thick)),
        (5, step / (shear * rectangle_torsion(np.full_like(thick, width), thick))),
    ):
        slices[:, place, place] = share
    expected = moved_along(slices, beyond).sum(0)
    size = np.sqrt(np.diag(expected))
    found = notch_compliance(width, web, radius, E_PA, NU, "s1")
    allowed = 2e-6 * max(1.0, radius / web)  # slices are steps of (pi / 4000)^2 radius / web in thickness
    assert_close(found / np.outer(size, size), expected / np.outer(size, size), atol=allowed, what="compliance")


@given(seed=SEEDS)
def test_parts_are_passive_and_symmetric(seed: int) -> None:
    rng = np.random.default_rng(seed)
    length, width, thin = rng.uniform(0.005, 0.1), 0.03, rng.uniform(0.001, 0.03)
    for part in (
        cylinder_compliance(length, thin, E_PA, NU),
        leaf_compliance(length, width, thin, E_PA, NU, "s1"),
        notch_compliance(width, thin, length, E_PA, NU, "s2"),
        universal_joint(leaf_compliance(length, width, thin, E_PA, NU, "s1"), length),
    ):
        size = np.sqrt(np.diag(part))
        scaled = part / np.outer(size, size)
        assert_close(scaled, scaled.T, atol=1e-15, what="asymmetry")
        assert np.linalg.eigvalsh(scaled)[0] > 0.0


@given(one=st.floats(-1.0, 1.0), other=st.floats(-1.0, 1.0), seed=SEEDS)
def test_transports_add_up_and_keep_power(one: float, other: float, seed: int) -> None:
    assert_close(transport(np.array(one)) @ transport(np.array(other)), transport(np.array(one + other)), atol=1e-15)
    rng = np.random.default_rng(seed)
    wrench, motion = rng.normal(size=(2, 6))
    T = transport(np.array(one))
    assert_close((T @ wrench) @ motion, wrench @ (T.T @ motion), atol=1e-13, what="power")


def test_soft_axes_are_a_quarter_turn_apart() -> None:
    for first, second in (
        (leaf_compliance(0.02, 0.03, 0.006, E_PA, NU, "s1"), leaf_compliance(0.02, 0.03, 0.006, E_PA, NU, "s2")),
        (notch_compliance(0.02, 0.002, 0.006, E_PA, NU, "s1"), notch_compliance(0.02, 0.002, 0.006, E_PA, NU, "s2")),
    ):
        assert_close(_quarter(first), second, atol=1e-18, what="turned")
        assert first[3, 3] > 5 * first[4, 4], "soft about s1, which is x"


@pytest.mark.parametrize("soft", ["s3", "x"])
def test_invalid_parts_are_refused(soft: str) -> None:
    with pytest.raises(ValueError, match="expected s1 or s2"):
        leaf_compliance(0.02, 0.03, 0.006, E_PA, NU, soft)
    with pytest.raises(ValueError, match="expected a thickness of at most the width"):
        leaf_compliance(0.02, 0.006, 0.03, E_PA, NU, "s1")


def test_torsion_of_a_flat_rectangle_is_that_of_its_series() -> None:
    """Saint-Venant's series, Timoshenko and Goodier, section 109."""
    a, b = 3.0, 1.0
    odd = np.arange(1, 40, 2)
    series = a * b**3 / 3 * (1 - 192 * b / (np.pi**5 * a) * np.sum(np.tanh(odd * np.pi * a / (2 * b)) / odd**5))
    found = float(rectangle_torsion(np.array(b), np.array(a)))
    assert_between(found / series, 0.9985, 1.0015, what="torsion constant")
