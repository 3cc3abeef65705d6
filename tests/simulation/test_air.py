"""The refractive index of air against published values, and its slopes against the complex step."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tolerance import assert_close
from truing.simulation.air import (
    ciddor_index,
    edlen_index,
    edlen_slopes,
    index_sigma,
    saturation_vapour_pressure_pa,
    vapour_pressure_pa,
)

# Stone and Zimmerman (NIST, Index of Refraction of Air): degrees C, % humidity, kPa, nm, by Ciddor, by Edlén.
NIST = np.array([
    (20, 0, 101.325, 633, 1.000271800, 1.000271799), (20, 0, 60, 633, 1.000160924, 1.000160920),
    (20, 0, 120, 633, 1.000321916, 1.000321918), (50, 0, 100, 633, 1.000243285, 1.000243270),
    (5, 0, 100, 633, 1.000282756, 1.000282750), (-40, 0, 100, 633, 1.000337580, 1.000337471),
    (50, 100, 120, 633, 1.000287924, 1.000287864), (40, 75, 120, 633, 1.000299418, 1.000299406),
    (20, 100, 100, 633, 1.000267394, 1.000267394), (40, 100, 110, 1700, 1.000270247, 1.000270237),
    (20, 0, 101.325, 1700, 1.000268479, 1.000268483), (40, 100, 110, 300, 1.000289000, 1.000288922),
    (20, 0, 101.325, 300, 1.000286581, 1.000286579), (-40, 0, 120, 300, 1.000427233, 1.000427072),
])  # fmt: skip
# Ciddor (1996), 633 nm, (n - 1) 1e8. Table 1, dry: degrees C, kPa. Table 2: degrees C, Pa, vapour in Pa, ppm of CO2.
DRY = np.array(
    [(20, 80, 21458.0), (20, 100, 26824.4), (20, 120, 32191.6), (10, 100, 27774.7), (30, 100, 25937.2)], float
)
MOIST = np.array([
    (19.526, 102094.8, 1065, 510, 27392.9), (19.517, 102096.8, 1065, 510, 27394.0),
    (19.173, 102993.0, 641, 450, 27682.4), (19.173, 103006.0, 642, 440, 27685.8),
    (19.188, 102918.8, 706, 450, 27658.7), (19.189, 102927.8, 708, 440, 27660.8),
    (19.532, 103603.2, 986, 600, 27802.0), (19.534, 103596.2, 962, 600, 27800.8),
    (19.534, 103599.2, 951, 610, 27802.2),
])  # fmt: skip
# Table 3: degrees C, kPa, % humidity. Its third row prints 19996.5, which its own column of differences contradicts.
EXTREME = np.array([
    (20, 80, 75, 21394.0), (20, 120, 75, 32127.8), (40, 80, 75, 19896.5), (40, 120, 75, 29941.8),
    (50, 80, 100, 19058.4), (50, 120, 100, 28792.4),
])  # fmt: skip


def test_both_equations_agree_with_the_values_of_nist() -> None:
    t, humidity, kpa, nm, ciddor, edlen = NIST.T
    vapour = vapour_pressure_pa(t, humidity / 100.0)
    assert_close(ciddor_index(1e-9 * nm, t, 1e3 * kpa, vapour), ciddor, atol=1e-9)
    assert_close(edlen_index(1e-9 * nm, t, 1e3 * kpa, vapour), edlen, atol=5.1e-10)


def test_ciddor_agrees_with_the_tables_of_his_paper() -> None:
    dry = ciddor_index(633e-9, DRY[:, 0], 1e3 * DRY[:, 1])
    assert_close(1e8 * (dry - 1.0), DRY[:, 2], atol=0.051)
    moist = ciddor_index(633e-9, *MOIST[:, :4].T)
    # the second row is 0.33 off where all others agree to the printed digit
    assert_close(1e8 * (moist - 1.0), MOIST[:, 4], atol=0.35)
    assert_close(np.delete(1e8 * (moist - 1.0), 1), np.delete(MOIST[:, 4], 1), atol=0.0551)
    t, kpa, humidity, expected = EXTREME.T
    extreme = ciddor_index(633e-9, t, 1e3 * kpa, vapour_pressure_pa(t, humidity / 100.0))
    assert_close(1e8 * (extreme - 1.0), expected, atol=0.051)


@given(st.floats(0.0, 40.0), st.floats(7e4, 1.1e5), st.floats(0.0, 1.0), st.floats(500e-9, 800e-9))
def test_the_slopes_are_exact_and_the_equations_agree(
    t: float, pressure: float, humidity: float, wavelength: float
) -> None:
    at = (t, pressure, float(vapour_pressure_pa(t, humidity)))
    step = 1e-30
    shifted = [
        edlen_index(wavelength, *(value + 1j * step * (k == j) for j, value in enumerate(at))).imag / step
        for k in range(3)
    ]
    slopes = edlen_slopes(wavelength, *at)
    assert_close(slopes / shifted, np.ones(3), atol=1e-12)
    apart = abs(ciddor_index(wavelength, *at) - edlen_index(wavelength, *at))
    assert apart < 6e-8  # as far apart as NIST's own values at 50 degrees, saturated


def test_one_kelvin_and_one_hectopascal_are_worth_what_workshops_reckon() -> None:
    by_kelvin, by_pascal, by_vapour = edlen_slopes(633e-9, 20.0, 101325.0, 1170.0)
    assert_close([1e6 * by_kelvin, 1e8 * by_pascal, 1e10 * by_vapour], [-0.93, 0.268, -3.63], atol=0.01)
    sigma = index_sigma([by_kelvin, by_pascal, by_vapour], [0.1, 10.0, 100.0])
    parts = np.array([0.1 * by_kelvin, 10.0 * by_pascal, 100.0 * by_vapour, 1e-8])
    assert_close(sigma, np.linalg.norm(parts), atol=1e-15)


def test_vapour_pressure_is_one_at_freezing_and_known_at_20_degrees() -> None:
    below, above = saturation_vapour_pressure_pa([-1e-9, 0.0])
    assert below == pytest.approx(above, rel=1e-4)  # over ice and over water they meet at 0.01 degrees
    assert_close(saturation_vapour_pressure_pa(20.0), 2339.2, atol=0.1)  # IAPWS-IF97: 2339.2 Pa
