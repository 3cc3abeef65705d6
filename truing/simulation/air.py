"""Refractive index of moist air: Ciddor (1996), the updated Edlén equation, and their derivatives and uncertainty.

P. E. Ciddor, Appl. Opt. 35 (1996) 1566; K. P. Birch and M. J. Downs, Metrologia 30 (1993) 155 and 31 (1994) 315, with
the water vapour term of J. A. Stone and J. H. Zimmerman (NIST, Index of Refraction of Air, appendix A). Wavelengths are
those in vacuum; all arguments broadcast.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array

ZERO_C_K = 273.15
_STANDARD_PA, _STANDARD_C = 101325.0, 15.0  # reference state of the dispersion of dry air
_VAPOUR_PA, _VAPOUR_C = 1333.0, 20.0  # reference state of the dispersion of water vapour
_EDLEN_D, _EDLEN_E, _EDLEN_F, _EDLEN_G = 96095.43, 0.601, 0.00972, 0.003661
_COLDEST_WATER_C = 0.0  # over ice below


def saturation_vapour_pressure_pa(temperature_c: ArrayLike) -> Array:
    """Return the vapour pressure over water (IAPWS), below 0 degrees over ice, in Pa."""
    kelvin = np.asarray(temperature_c, float) + ZERO_C_K
    return np.where(kelvin >= _COLDEST_WATER_C + ZERO_C_K, _over_water(kelvin), _over_ice(kelvin))


def _over_water(kelvin: Array) -> Array:
    omega = kelvin - 2.38555575678e-1 / (kelvin - 6.50175348448e2)
    A = omega**2 + 1.16705214528e3 * omega - 7.24213167032e5
    B = -1.70738469401e1 * omega**2 + 1.20208247025e4 * omega - 3.23255503223e6
    C = 1.49151086135e1 * omega**2 - 4.82326573616e3 * omega + 4.05113405421e5
    return 1e6 * (2.0 * C / (-B + np.sqrt(B**2 - 4.0 * A * C))) ** 4


def _over_ice(kelvin: Array) -> Array:
    theta = kelvin / 273.16
    exponent = -13.928169 * (1.0 - theta**-1.5) + 34.7078238 * (1.0 - theta**-1.25)
    return 611.657 * np.exp(exponent)


def vapour_pressure_pa(temperature_c: ArrayLike, relative_humidity: ArrayLike) -> Array:
    """Return the partial pressure of water vapour in Pa; relative humidity from 0 to 1."""
    return np.asarray(relative_humidity, float) * saturation_vapour_pressure_pa(temperature_c)


def ciddor_index(
    wavelength_m: ArrayLike,
    temperature_c: ArrayLike,
    pressure_pa: ArrayLike,
    vapour_pa: ArrayLike = 0.0,
    co2_ppm: ArrayLike = 450.0,
) -> Array:
    """Return the phase index of moist air by Ciddor's equations; vapour_pa is the partial pressure of water vapour."""
    t, p, vapour, co2 = (np.asarray(value, float) for value in (temperature_c, pressure_pa, vapour_pa, co2_ppm))
    s = _wave_number_squared(wavelength_m)
    dry = 1e-8 * (5792105.0 / (238.0185 - s) + 167917.0 / (57.362 - s)) * (1.0 + 0.534e-6 * (co2 - 450.0))
    wet = 1.022e-8 * (295.235 + s * (2.6422 + s * (-0.032380 + s * 0.004028)))
    share = (1.00062 + 3.14e-8 * p + 5.6e-7 * t**2) * vapour / p  # mole fraction of water vapour
    density = p / (_compressibility(t, p, share) * (t + ZERO_C_K))
    return 1.0 + density * (
        (1.0 - share) * dry / _density(_STANDARD_C, _STANDARD_PA, 0.0)
        + share * wet / _density(_VAPOUR_C, _VAPOUR_PA, 1.0)
    )


def _wave_number_squared(wavelength_m: ArrayLike) -> Array:
    """Return the square of the wave number in vacuum, 1/um^2."""
    return np.asarray((1e6 * np.asarray(wavelength_m, float)) ** -2.0)


def _density(t: float, p: float, share: float) -> float:
    """Return the molar density times the gas constant; only its ratios are needed."""
    return p / (_compressibility(t, p, share) * (t + ZERO_C_K))


def _compressibility(t: Any, p: Any, share: Any) -> Any:
    """Return Z of moist air (Ciddor eq. 12)."""
    by_kelvin = p / (t + ZERO_C_K)
    first = 1.58123e-6 + t * (-2.9331e-8 + t * 1.1043e-10)
    first = first + (5.707e-6 - 2.051e-8 * t) * share + (1.9898e-4 - 2.376e-6 * t) * share**2
    return 1.0 - by_kelvin * first + by_kelvin**2 * (1.83e-11 - 0.765e-8 * share**2)


def edlen_index(
    wavelength_m: ArrayLike, temperature_c: ArrayLike, pressure_pa: ArrayLike, vapour_pa: ArrayLike = 0.0
) -> Array:
    """Return the phase index of moist air (450 ppm of CO2) by the updated Edlén equation."""
    t, p, vapour = (np.asarray(value) for value in (temperature_c, pressure_pa, vapour_pa))
    dry, wet = _edlen_dispersion(wavelength_m)
    compressed = p * (1.0 + 1e-8 * (_EDLEN_E - _EDLEN_F * t) * p)
    return 1.0 + dry * compressed / (_EDLEN_D * (1.0 + _EDLEN_G * t)) - wet * vapour / (t + ZERO_C_K)


def edlen_slopes(
    wavelength_m: ArrayLike, temperature_c: ArrayLike, pressure_pa: ArrayLike, vapour_pa: ArrayLike = 0.0
) -> Array:
    """Return the derivatives (..., 3) of the index by temperature (1/K), pressure and vapour pressure (1/Pa)."""
    t, p, vapour = np.broadcast_arrays(*(np.asarray(v, float) for v in (temperature_c, pressure_pa, vapour_pa)))
    dry, wet = _edlen_dispersion(wavelength_m)
    thin = 1.0 + _EDLEN_G * t
    compressed = 1.0 + 1e-8 * (_EDLEN_E - _EDLEN_F * t) * p
    by_temperature = -dry * p / _EDLEN_D * (1e-8 * _EDLEN_F * p * thin + _EDLEN_G * compressed) / thin**2
    by_temperature = by_temperature + wet * vapour / (t + ZERO_C_K) ** 2
    by_pressure = dry * (2.0 * compressed - 1.0) / (_EDLEN_D * thin)
    by_vapour = np.broadcast_to(-wet / (t + ZERO_C_K), by_pressure.shape)
    return np.stack(np.broadcast_arrays(by_temperature, by_pressure, by_vapour), axis=-1)


def _edlen_dispersion(wavelength_m: ArrayLike) -> tuple[Array, Array]:
    """Return the dispersion of standard air, and that of water vapour (K/Pa)."""
    s = _wave_number_squared(wavelength_m)
    return 1e-8 * (8342.54 + 2406147.0 / (130.0 - s) + 15998.0 / (38.9 - s)), 292.75e-10 * (3.7345 - 0.0401 * s)


def index_sigma(slopes: ArrayLike, sigma: ArrayLike, equation: float = 1e-8) -> Array:
    """Return the standard deviation of the index from independent errors of temperature, pressure, vapour pressure
    (..., 3).

    ``equation`` is the error of the equation itself, about 1e-8 in ordinary air (Stone and Zimmerman).
    """
    return np.sqrt(np.sum((np.asarray(slopes, float) * np.asarray(sigma, float)) ** 2, axis=-1) + equation**2)
