"""Models of NIST's Statistical Reference Datasets for non-linear regression, with exact derivatives.

Each takes parameters b (B, P) and a predictor x (N,), and returns values (B, N) and derivatives (B, N, P); formulas are
those that the heads of the files print.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Evaluated = tuple[NDArray, NDArray]
Model = Callable[[NDArray, NDArray], Evaluated]


def _columns(value: NDArray, *columns: NDArray) -> Evaluated:
    return value, np.stack(np.broadcast_arrays(*columns), -1)


def _apart(b: NDArray) -> NDArray:
    """Return the parameters, each (B, 1)."""
    return b.T[..., None]


def bennett(b: NDArray, x: NDArray) -> Evaluated:
    """b1 (b2 + x)^(-1/b3)."""
    b1, b2, b3 = _apart(b)
    power = (b2 + x) ** (-1.0 / b3)
    value = b1 * power
    return _columns(value, power, -value / (b3 * (b2 + x)), value * np.log(b2 + x) / b3**2)


def saturation(b: NDArray, x: NDArray) -> Evaluated:
    """b1 (1 - exp(-b2 x))."""
    b1, b2 = _apart(b)
    fall = np.exp(-b2 * x)
    return _columns(b1 * -np.expm1(-b2 * x), -np.expm1(-b2 * x), b1 * x * fall)


def chwirut(b: NDArray, x: NDArray) -> Evaluated:
    """exp(-b1 x) / (b2 + b3 x)."""
    b1, b2, b3 = _apart(b)
    below = b2 + b3 * x
    value = np.exp(-b1 * x) / below
    return _columns(value, -x * value, -value / below, -x * value / below)


def power_law(b: NDArray, x: NDArray) -> Evaluated:
    """b1 x^b2."""
    b1, b2 = _apart(b)
    power = x**b2
    return _columns(b1 * power, power, b1 * power * np.log(x))


def enso(b: NDArray, x: NDArray) -> Evaluated:
    """A yearly cycle and two cycles of unknown period b4 and b7."""
    b1, b2, b3, b4, b5, b6, b7, b8, b9 = _apart(b)
    value, columns = b1, [np.ones_like(b1)]
    for period, c, s, free in ((12.0, b2, b3, False), (b4, b5, b6, True), (b7, b8, b9, True)):
        angle = 2.0 * np.pi * x / period
        cosine, sine = np.cos(angle), np.sin(angle)
        value = value + c * cosine + s * sine
        columns += [(c * sine - s * cosine) * angle / period] * free + [cosine, sine]
    return _columns(value, *columns)


def eckerle(b: NDArray, x: NDArray) -> Evaluated:
    """(b1 / b2) exp(-((x - b3) / b2)^2 / 2)."""
    b1, b2, b3 = _apart(b)
    t = (x - b3) / b2
    bell = np.exp(-0.5 * t**2) / b2
    return _columns(b1 * bell, bell, b1 * bell * (t**2 - 1.0) / b2, b1 * bell * t / b2)


def two_bells(b: NDArray, x: NDArray) -> Evaluated:
    """b1 exp(-b2 x) and two bells: height b3, centre b4, width b5; b6, b7, b8."""
    b1, b2, b3, b4, b5, b6, b7, b8 = _apart(b)
    fall = np.exp(-b2 * x)
    value, columns = b1 * fall, [fall, -x * b1 * fall]
    for height, centre, width in ((b3, b4, b5), (b6, b7, b8)):
        t = (x - centre) / width
        bell = np.exp(-(t**2))
        value = value + height * bell
        columns += [bell, 2.0 * height * bell * t / width, 2.0 * height * bell * t**2 / width]
    return _columns(value, *columns)


def rational(above: int, below: int) -> Model:
    """Polynomial of a degree over 1 plus a polynomial without constant term."""

    def model(b: NDArray, x: NDArray) -> Evaluated:
        up, down = x[:, None] ** np.arange(above + 1), x[:, None] ** np.arange(1, below + 1)
        denominator = 1.0 + b[:, above + 1 :] @ down.T
        value = b[:, : above + 1] @ up.T / denominator
        return value, np.concatenate([up / denominator[..., None], -down * (value / denominator)[..., None]], -1)

    return model


def three_decays(b: NDArray, x: NDArray) -> Evaluated:
    """b1 exp(-b2 x) + b3 exp(-b4 x) + b5 exp(-b6 x)."""
    parts = [(size, np.exp(-rate * x)) for size, rate in _apart(b).reshape(3, 2, -1, 1)]
    columns = [column for size, fall in parts for column in (fall, -x * size * fall)]
    return _columns(sum((size * fall for size, fall in parts), np.zeros(1)), *columns)


def mgh09(b: NDArray, x: NDArray) -> Evaluated:
    """b1 (x^2 + b2 x) / (x^2 + b3 x + b4)."""
    b1, b2, b3, b4 = _apart(b)
    below = x**2 + b3 * x + b4
    shape = (x**2 + b2 * x) / below
    return _columns(b1 * shape, shape, b1 * x / below, -b1 * shape * x / below, -b1 * shape / below)


def mgh10(b: NDArray, x: NDArray) -> Evaluated:
    """b1 exp(b2 / (x + b3))."""
    b1, b2, b3 = _apart(b)
    growth = np.exp(b2 / (x + b3))
    value = b1 * growth
    return _columns(value, growth, value / (x + b3), -value * b2 / (x + b3) ** 2)


def mgh17(b: NDArray, x: NDArray) -> Evaluated:
    """b1 + b2 exp(-b4 x) + b3 exp(-b5 x)."""
    b1, b2, b3, b4, b5 = _apart(b)
    first, second = np.exp(-b4 * x), np.exp(-b5 * x)
    value = b1 + b2 * first + b3 * second
    return _columns(value, np.ones_like(first), first, second, -x * b2 * first, -x * b3 * second)


def misra1b(b: NDArray, x: NDArray) -> Evaluated:
    """b1 (1 - (1 + b2 x / 2)^-2)."""
    b1, b2 = _apart(b)
    base = 1.0 + b2 * x / 2.0
    return _columns(b1 * (1.0 - base**-2), 1.0 - base**-2, b1 * x * base**-3)


def misra1c(b: NDArray, x: NDArray) -> Evaluated:
    """b1 (1 - (1 + 2 b2 x)^-1/2)."""
    b1, b2 = _apart(b)
    base = 1.0 + 2.0 * b2 * x
    return _columns(b1 * (1.0 - base**-0.5), 1.0 - base**-0.5, b1 * x * base**-1.5)


def misra1d(b: NDArray, x: NDArray) -> Evaluated:
    """b1 b2 x / (1 + b2 x)."""
    b1, b2 = _apart(b)
    base = 1.0 + b2 * x
    return _columns(b1 * b2 * x / base, b2 * x / base, b1 * x / base**2)


def nelson(b: NDArray, x: NDArray) -> Evaluated:
    """b1 - b2 x1 exp(-b3 x2), the logarithm of the response; x (N, 2)."""
    b1, b2, b3 = _apart(b)
    first, second = x.T
    fall = first * np.exp(-b3 * second)
    return _columns(b1 - b2 * fall, np.ones_like(fall), -fall, b2 * second * fall)


def rat42(b: NDArray, x: NDArray) -> Evaluated:
    """b1 / (1 + exp(b2 - b3 x))."""
    b1, b2, b3 = _apart(b)
    growth = np.exp(b2 - b3 * x)
    share = 1.0 / (1.0 + growth)
    slope = b1 * growth * share**2
    return _columns(b1 * share, share, -slope, x * slope)


def rat43(b: NDArray, x: NDArray) -> Evaluated:
    """b1 / (1 + exp(b2 - b3 x))^(1/b4)."""
    b1, b2, b3, b4 = _apart(b)
    growth = np.exp(b2 - b3 * x)
    share = (1.0 + growth) ** (-1.0 / b4)
    slope = b1 * share * growth / (b4 * (1.0 + growth))
    return _columns(b1 * share, share, -slope, x * slope, b1 * share * np.log(1.0 + growth) / b4**2)


def roszman(b: NDArray, x: NDArray) -> Evaluated:
    """b1 - b2 x - arctan(b3 / (x - b4)) / pi."""
    b1, b2, b3, b4 = _apart(b)
    gap = x - b4
    square = np.pi * (gap**2 + b3**2)
    return _columns(b1 - b2 * x - np.arctan(b3 / gap) / np.pi, np.ones_like(gap), -x, -gap / square, -b3 / square)


MODELS: dict[str, Model] = {
    "Bennett5": bennett,
    "BoxBOD": saturation,
    "Chwirut1": chwirut,
    "Chwirut2": chwirut,
    "DanWood": power_law,
    "ENSO": enso,
    "Eckerle4": eckerle,
    "Gauss1": two_bells,
    "Gauss2": two_bells,
    "Gauss3": two_bells,
    "Hahn1": rational(3, 3),
    "Kirby2": rational(2, 2),
    "Lanczos1": three_decays,
    "Lanczos2": three_decays,
    "Lanczos3": three_decays,
    "MGH09": mgh09,
    "MGH10": mgh10,
    "MGH17": mgh17,
    "Misra1a": saturation,
    "Misra1b": misra1b,
    "Misra1c": misra1c,
    "Misra1d": misra1d,
    "Nelson": nelson,
    "Rat42": rat42,
    "Rat43": rat43,
    "Roszman1": roszman,
    "Thurber": rational(3, 3),
}
