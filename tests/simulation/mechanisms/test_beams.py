"""Beams, and a leg of flexure, tube and flexure: reference values, laws of elasticity, condensation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.simulation.mechanisms.flexure_telescope import (
    FLEXURE,
    FLEXURE_M,
    REFERENCE,
    STEP,
    TUBE,
    TUBE_M,
    in_mm,
    vector,
)
from tests.simulation.mechanisms.telescope import telescope
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.structures.beams import (
    Chain,
    assembled,
    assembled_change,
    beam_axes,
    condensed,
    condensed_change,
    element_change,
    element_stiffness,
    in_frame,
    nodes,
    recovery_matrix,
    section,
)
from truing.simulation.mechanisms.structures.structure import BeamSection

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
def test_sections_are_those_of_the_reference(part: BeamSection, name: str) -> None:
    expected = REFERENCE["flexure"][name]
    for found, key, si in ((part.bending, "k1_EI", 1e-6), (part.axial, "k2_ES", 1.0), (part.torsion, "k3_GJ", 1e-6)):
        assert_close(found, expected[key] * si, atol=1e-9 * found, what=key)


def test_stiffness_is_that_of_the_reference() -> None:
    inputs, outputs = vector("eq21")
    beam = BeamSection(inputs["k1"] * 1e-6, inputs["k2"], inputs["k3"] * 1e-6)
    expected = np.array(outputs["K"])
    found = in_mm(element_stiffness(np.array(inputs["l_mm"] * 1e-3), beam))
    assert_close(found, expected, atol=1e-9 * np.abs(expected).max(), what="K")
    assert_close(found, in_mm(element_stiffness(np.array(FLEXURE_M), FLEXURE)), atol=1e-9 * 4e4, what="of the flexure")


@given(length=LENGTHS, beam=SECTIONS)
def test_no_rigid_motion_loads_a_beam_and_every_other_does(length: float, beam: BeamSection) -> None:
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
def test_a_cantilever_bends_as_in_the_textbook(length: float, beam: BeamSection) -> None:
    """Displacements of the free end by its loads, from the integrals of the curvature."""
    k1, k2, k3 = beam.bending, beam.axial, beam.torsion
    sag, tilt, turn = length**3 / (3 * k1), length**2 / (2 * k1), length / k1
    flexibility = np.diag([length / k2, sag, sag, length / k3, turn, turn])
    flexibility[1, 5] = flexibility[5, 1] = tilt
    flexibility[2, 4] = flexibility[4, 2] = -tilt
    free = element_stiffness(np.array(length), beam)[6:, 6:]
    assert_close(free @ flexibility, np.eye(6), atol=1e-12 * max(1.0, length, 1 / length), what="K times flexibility")


@given(length=LENGTHS, beam=SECTIONS)
def test_derivatives_of_an_element_agree_with_a_complex_step(length: float, beam: BeamSection) -> None:
    inputs = np.array([length, beam.bending, beam.axial, beam.torsion])
    found = element_change(np.array(length), beam)
    for j in range(4):
        nudged = inputs + 1j * STEP * np.eye(4)[j]
        expected = element_stiffness(nudged[0], BeamSection(*nudged[1:])).imag / STEP
        assert_close(found[j], expected, atol=1e-14 * np.abs(expected).max(), what=f"by input {j}")


def test_a_batch_of_beams_gives_the_results_of_single_beams() -> None:
    lengths = np.array([[0.01, 0.02, 0.4], [0.1, 0.2, 0.3]])
    stiffness, change = element_stiffness(lengths, FLEXURE), element_change(lengths, FLEXURE)
    for place in np.ndindex(2, 3):
        alone = element_stiffness(lengths[place], FLEXURE)
        assert_close(stiffness[place], alone, atol=1e-15 * np.abs(alone).max(), what="K")
        alone = element_change(lengths[place], FLEXURE)
        assert_close(change[place], alone, atol=1e-15 * np.abs(alone).max(), what="dK")


LEG = Chain(np.array(FLEXURE_M), np.array(TUBE_M), FLEXURE, TUBE)
SEEDS = st.integers(0, 2**32 - 1)


def _drawn(rng: np.random.Generator) -> Chain:
    def beam(like: BeamSection) -> BeamSection:
        return BeamSection(*(np.array([like.bending, like.axial, like.torsion]) * rng.uniform(0.5, 2.0, 3)))

    return Chain(rng.uniform(0.005, 0.02), rng.uniform(0.2, 0.8), beam(FLEXURE), beam(TUBE))


def _motion(rng: np.random.Generator, count: int) -> NDArray:
    """Displacements, m and rad, of such a size that all parts of the energy count."""
    return rng.normal(size=count) * np.tile(np.repeat([1e-4, 1e-3], 3), count // 6)


def test_nodes_are_those_of_the_reference() -> None:
    inputs, outputs = vector("eq22")
    legs, z0 = telescope(), np.array(REFERENCE["home"]["z0"])
    half = 0.5 * inputs["l_b_mm"] * 1e-3 * z0
    found = nodes(legs.closure.lower(legs, legs.rho0), legs.b, half, np.array(REFERENCE["home"]["R0"]))
    names = {"a": "a_prime", "c": "c_prime", "d": "d_prime_platform", "b": "b_prime_platform"}
    for name, key in names.items():
        assert_close(getattr(found, name)[0] * 1e3, outputs[key], atol=1e-9 * 500.0, what=key)
    standing = np.array(REFERENCE["home"]["p0"]) * 1e-3 + found.d - found.c  # R0 is the identity
    assert_close(np.linalg.norm(standing[0]) * 1e3, outputs["c_to_d_length"], atol=1e-9 * 500.0, what="tube, mm")


def test_nodes_on_the_platform_are_in_its_frame() -> None:
    R0 = exp_so3(np.array([0.3, -0.2, 0.5]))
    upper, half = np.array([0.1, 0.2, 0.0]), np.array([0.0, 0.001, 0.005])
    found = nodes(np.zeros(3), upper, half, R0)
    assert_close(R0 @ (found.b - upper), half, atol=1e-17, what="from the joint to b', base frame")
    assert_close(found.b - upper, upper - found.d, atol=1e-16, what="d' opposite")


def test_condensed_chain_is_that_of_the_reference() -> None:
    _, outputs = vector("eq27")
    whole, expected = in_mm(assembled(LEG)), np.array(outputs["K"])
    assert_close(np.trace(whole), outputs["trace_K24"], atol=1e-9 * outputs["trace_K24"], what="trace")
    norm = outputs["frobenius_K24"]
    assert_close(np.linalg.norm(whole), norm, atol=1e-9 * norm, what="norm")
    assert_close(in_mm(condensed(assembled(LEG))), expected, atol=1e-9 * np.abs(expected).max(), what="K")


def test_chain_in_the_base_frame_is_that_of_the_reference() -> None:
    inputs, outputs = vector("eq28")
    expected, axes = np.array(outputs["K"]), beam_axes(np.array(inputs["z0"]))
    assert_close(axes[:, 0], np.array(inputs["beam_axes_columns"])[:, 0], atol=1e-9, what="axis of the leg")
    found = in_mm(in_frame(condensed(assembled(LEG)), axes))
    assert_close(found, expected, atol=1e-9 * np.abs(expected).max(), what="K")


@given(seed=SEEDS)
def test_a_leg_pulled_is_three_springs_in_series(seed: int) -> None:
    leg = _drawn(np.random.default_rng(seed))
    series = 1 / (2 * leg.flexure_length / leg.flexure.axial + leg.tube_length / leg.tube.axial)
    twisted = 1 / (2 * leg.flexure_length / leg.flexure.torsion + leg.tube_length / leg.tube.torsion)
    found = condensed(assembled(leg))
    assert_close(found[0, 0], series, atol=1e-12 * series, what="axial")
    assert_close(found[3, 3], twisted, atol=1e-12 * twisted, what="torsion")


@given(seed=SEEDS)
def test_condensation_leaves_the_least_energy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    whole = assembled(_drawn(rng))
    ends = _motion(rng, 12)
    least = 0.5 * ends @ condensed(whole) @ ends
    settled = recovery_matrix(whole) @ ends
    energy = 0.5 * settled @ whole @ settled
    rounding = 1e-12 * np.abs(settled) @ np.abs(whole) @ np.abs(settled)
    assert_close(energy, least, atol=rounding, what="energy, J")
    settled[6:18] += _motion(rng, 12)
    assert 0.5 * settled @ whole @ settled > least
    assert least > 0


@given(seed=SEEDS)
def test_a_condensed_leg_is_symmetric_and_free_to_move_as_a_whole(seed: int) -> None:
    leg = _drawn(np.random.default_rng(seed))
    found = condensed(assembled(leg))
    assert_close(found, found.T, atol=1e-12 * np.abs(found).max(), what="asymmetry")
    motions = rigid_motions([0.0, 2 * leg.flexure_length + leg.tube_length])
    assert_close(found @ motions, np.zeros((12, 6)), atol=1e-11 * np.abs(found).max(), what="loads")
    assert np.linalg.matrix_rank(found[6:, 6:]) == 6, "with its root held it gives in to nothing freely"


@given(seed=SEEDS)
def test_a_leg_turned_end_for_end_is_the_same_leg(seed: int) -> None:
    found = condensed(assembled(_drawn(np.random.default_rng(seed))))
    about_z = np.tile([-1.0, -1.0, 1.0], 4)  # half a turn about local z
    swapped = np.r_[6:12, 0:6]
    turned = (found * np.outer(about_z, about_z))[np.ix_(swapped, swapped)]
    assert_close(turned, found, atol=1e-12 * np.abs(found).max(), what="K")


@given(seed=SEEDS)
def test_only_the_axis_of_a_round_leg_matters(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, local = exp_so3(rng.normal(size=3)), condensed(assembled(LEG))
    z = np.array([0.0, 0.0, 1.0]) if seed % 2 else turn[:, 2]  # the report's frame has no x for a vertical leg
    found = in_frame(local, beam_axes(z))
    rolled = in_frame(local, exp_so3(rng.normal() * z) @ beam_axes(z))
    assert_close(rolled, found, atol=1e-13 * np.abs(found).max(), what="rolled")
    elsewhere = in_frame(local, beam_axes(turn @ z))
    assert_close(elsewhere, in_frame(found, turn), atol=1e-13 * np.abs(found).max(), what="turned")


@pytest.mark.parametrize("entry", range(8))
def test_derivatives_agree_with_a_complex_step(entry: int) -> None:
    leg = _drawn(np.random.default_rng(3))
    flexure, tube = ([part.bending, part.axial, part.torsion] for part in (leg.flexure, leg.tube))
    nudged = np.array([leg.flexure_length, leg.tube_length, *flexure, *tube]) + 1j * STEP * np.eye(8)[entry]
    whole = assembled(Chain(nudged[0], nudged[1], BeamSection(*nudged[2:5]), BeamSection(*nudged[5:])))
    expected = condensed(whole).imag / STEP
    found = condensed_change(assembled(leg), assembled_change(leg))[entry]
    # stiffness is won from differences of stiffer parts
    assert_close(found, expected, atol=1e-11 * np.abs(expected).max(), what=f"by input {entry}")


def test_a_batch_of_legs_gives_the_results_of_single_legs() -> None:
    lengths = np.array([[0.008, 0.01, 0.012]]), np.array([[0.48], [0.5]])
    flexures, tubes = np.broadcast_arrays(*lengths)
    axes = beam_axes(exp_so3(np.random.default_rng(0).normal(size=(2, 3, 3)))[..., 0])
    found = in_frame(condensed(assembled(Chain(flexures, tubes, FLEXURE, TUBE))), axes)
    for place in np.ndindex(2, 3):
        alone = in_frame(condensed(assembled(Chain(flexures[place], tubes[place], FLEXURE, TUBE))), axes[place])
        assert_close(found[place], alone, atol=1e-13 * np.abs(alone).max(), what="K")
