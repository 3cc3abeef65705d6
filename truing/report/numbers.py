"""Numbers as a reader wants them: rounded to what their uncertainty supports, with unit."""

from __future__ import annotations

import math


def with_uncertainty(value: float, sigma: float | None, unit: str = "") -> str:
    """``13.2 ± 0.4 um``: two digits of the uncertainty where it begins with 1 or 2, else one (GUM 7.2.6)."""
    if sigma is None or not math.isfinite(sigma) or sigma <= 0.0:
        return f"{plain(value)} {unit}".strip()
    digits = decimals(sigma)
    return f"{value:.{digits}f} ± {sigma:.{digits}f} {unit}".strip()


def decimals(sigma: float) -> int:
    """How many decimals a number with this uncertainty keeps (at most 12, never negative)."""
    exponent = math.floor(math.log10(sigma))
    leading = sigma / 10.0**exponent
    return min(12, max(0, -exponent + (1 if leading < 2.95 else 0)))


def plain(value: float | None) -> str:
    """Four significant digits, without a power of ten where a reader does not need one; a dash for nothing."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    if value == int(value) and abs(value) < 1e6:
        return str(int(value))
    if not 1e-3 <= abs(value) < 1e6:
        return f"{value:.2e}"
    return f"{value:.{max(0, 3 - math.floor(math.log10(abs(value))))}f}"


def p_value(p: float | None) -> str:
    """A p-value as a reader wants it."""
    if p is None or not math.isfinite(p):
        return "–"
    return "< 1e-6" if p < 1e-6 else f"{p:.2g}"
