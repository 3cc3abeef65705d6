"""The beam element: reference values and the laws that every elastic body keeps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.simulation.mechanisms.flexure_telescope import FLEXURE, FLEXURE_M, REFERENCE, STEP, TUBE, in_mm, vector
from tests.tolerance import assert_close
from truing.simulation.mechanisms.structures.beams import element_change, element_stiffness, section
from truing.simulation.mechanisms.structures.structure import Section

LENGTHS = st.floats(0.01, 1.0)
SECTIONS = st.builds(section, st.floats(1e-3, 2e-2), st.floats(1e10, 3e11), st.floats(0.0, 0.45))
# Entries in metres and in radians are compared at the scale of a lever as long as the beam.


def _levered(stiffness: NDArray, length: float) -> NDArray:
    """The stiffness with rotations counted as motions at a lever of one length, in units of its largest entry."""
    size = np.tile(np.repeat([1.0, 1.0 / length], 3), 2)
    found = stiffness * np.outer(size, size)
    return found / np.abs(found).max()


def rigid_motions(along_x: list[float]) -> NDArray:
    """Displacements (6 N, 6) of N nodes on the x axis in the six rigid motions, rotations about the origin."""
    found = []
    for x in along_x:
        lever = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, x], [0.0, -x, 0.0]])  # w x (x, 0, 0)
        found.append(np.block([[np.eye(3), lever], [np.zeros((3, 3)), np.eye(3)]]))
    return np.concatenate(found)


@pytest.mark.parametrize(("part", "name"), [(FLEXURE, "kd"), (TUBE, "kl")])
def test_sections_are_those_of_the_reference(part: Section, name: str) -> None:
    expected = REFERENCE["flexure"][name]
    for found, key, si in ((part.bending, "k1_EI", 1e-6), (part.axial, "k2_ES", 1.0), (part.torsion, "k3_GJ", 1e-6)):
        assert_close(found, expected[key] * si, atol=1e-9 * found, what=key)


def test_stiffness_is_that_of_the_reference() -> None:
    inputs, outputs = vector("eq21")
    beam = Section(inputs["k1"] * 1e-6, inputs["k2"], inputs["k3"] * 1e-6)
    expected = np.array(outputs["K"])
    found = in_mm(element_stiffness(np.array(inputs["l_mm"] * 1e-3), beam))
    assert_close(found, expected, atol=1e-9 * np.abs(expected).max(), what="K")
    assert_close(found, in_mm(element_stiffness(np.array(FLEXURE_M), FLEXURE)), atol=1e-9 * 4e4, what="of the flexure")


@given(length=LENGTHS, beam=SECTIONS)
def test_no_rigid_motion_loads_a_beam_and_every_other_does(length: float, beam: Section) -> None:
    found = element_stiffness(np.array(length), beam)
    scaled = _levered(found, length)
    assert_close(found, found.T, atol=1e-15 * np.abs(found).max(), what="asymmetry")
    lever = np.diag(np.tile(np.repeat([1.0, length], 3), 2))
    motions = lever @ rigid_motions([0.0, length]) @ np.diag(np.repeat([1.0, 1.0 / length], 3))
    assert_close(scaled @ motions, np.zeros((12, 6)), atol=1e-14, what="loads")
    energies = np.linalg.eigvalsh(scaled)
    assert_close(energies[:6], np.zeros(6), atol=1e-14, what="energies of rigid motions")
    assert energies[6] > 1e-12, "a strained beam holds energy"


@given(length=LENGTHS, beam=SECTIONS)
def test_a_cantilever_bends_as_in_the_textbook(length: float, beam: Section) -> None:
    """Displacements of the free end by its loads, from the integrals of the curvature."""
    k1, k2, k3 = beam.bending, beam.axial, beam.torsion
    sag, tilt, turn = length**3 / (3 * k1), length**2 / (2 * k1), length / k1
    flexibility = np.diag([length / k2, sag, sag, length / k3, turn, turn])
    flexibility[1, 5] = flexibility[5, 1] = tilt
    flexibility[2, 4] = flexibility[4, 2] = -tilt
    free = element_stiffness(np.array(length), beam)[6:, 6:]
    assert_close(free @ flexibility, np.eye(6), atol=1e-12 * max(1.0, length, 1 / length), what="K times flexibility")


@given(length=LENGTHS, beam=SECTIONS)
def test_derivatives_agree_with_a_complex_step(length: float, beam: Section) -> None:
    inputs = np.array([length, beam.bending, beam.axial, beam.torsion])
    found = element_change(np.array(length), beam)
    for j in range(4):
        nudged = inputs + 1j * STEP * np.eye(4)[j]
        expected = element_stiffness(nudged[0], Section(*nudged[1:])).imag / STEP
        assert_close(found[j], expected, atol=1e-14 * np.abs(expected).max(), what=f"by input {j}")


def test_batches_of_beams_are_beams_one_by_one() -> None:
    lengths = np.array([[0.01, 0.02, 0.4], [0.1, 0.2, 0.3]])
    stiffness, change = element_stiffness(lengths, FLEXURE), element_change(lengths, FLEXURE)
    for place in np.ndindex(2, 3):
        alone = element_stiffness(lengths[place], FLEXURE)
        assert_close(stiffness[place], alone, atol=1e-15 * np.abs(alone).max(), what="K")
        alone = element_change(lengths[place], FLEXURE)
        assert_close(change[place], alone, atol=1e-15 * np.abs(alone).max(), what="dK")
