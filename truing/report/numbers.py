"""Text of numbers, rounded to their uncertainty, with units; and lists of names."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence

# Units for numbers with too many digits: from, below, unit, factor.
_HANDIER = {
    "mm": (0.0, 1.0, "um", 1e3),
    "um": (1e3, math.inf, "mm", 1e-3),
    "urad": (1e3, math.inf, "mrad", 1e-3),
}
TOO_LARGE = 1e4  # in a comparison with numbers in the same unit
_SIGNS = {"um": "µm", "urad": "µrad", "1": "", "N m": "N·m"}
LEAST_PRINTED_P = 1e-6  # smaller probabilities rest on tails of distributions that no data confirm


def with_uncertainty(value: float, sigma: float | None, unit: str = "") -> str:
    """Return ``13.24 ± 0.41 um``: two significant digits of the uncertainty, the value to the same place
    (GUM 7.2.6)."""
    if not math.isfinite(value):
        return plain(value)
    if sigma is None or not math.isfinite(sigma) or sigma <= 0.0:
        return f"{plain(value)} {unit}".strip()
    largest = max(abs(value), sigma)
    if 1e-4 <= largest < 1e7:
        return f"{_rounded(value, sigma)} ± {_rounded(sigma, sigma)} {unit}".strip()
    power = math.floor(math.log10(largest))
    value, sigma = value / 10.0**power, sigma / 10.0**power
    return f"({_rounded(value, sigma)} ± {_rounded(sigma, sigma)})e{power:+03d} {unit}".strip()


def _rounded(value: float, sigma: float) -> str:
    digits = _last_digit(sigma)
    return f"{round(value, digits) + 0.0:.{max(0, digits)}f}"  # no minus before a zero


def _last_digit(sigma: float) -> int:
    """Return the decimal place to which a number with this uncertainty is rounded (at most 12); negative left of the
    point."""
    exponent = int(f"{sigma:.1e}".partition("e")[2])  # of the rounded number: 0.996 is 1.0
    return min(12, 1 - exponent)


def plain(value: float | None) -> str:
    """Return three significant digits, mostly without a power of ten; a dash for missing values."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    if value == int(value) and abs(value) < 1e6:
        return str(int(value))
    if not 1e-3 <= abs(value) < 1e6:
        return f"{value:.2e}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def rough(value: float | None) -> str:
    """Return two significant digits, all before the point."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:,.0f}" if abs(value) >= 9.95 else f"{value:#.2g}"


def rough_quantity(value: float, unit: str) -> str:
    """Return two significant digits, all before the point, with the unit; from 10,000 on in a larger unit."""
    if abs(value) >= TOO_LARGE and unit in _HANDIER and _HANDIER[unit][1] == math.inf:
        _, _, unit, factor = _HANDIER[unit]
        value *= factor
    return f"{rough(value)} {sign(unit)}".rstrip()


def quantity(value: float | None, unit: str) -> str:
    """Return a number in a suitable unit: ``3.4 µm`` for 0.0034 mm; no unit for a ratio."""
    if value is None or not math.isfinite(value):
        return "–"
    if unit in _HANDIER:
        low, high, handier, factor = _HANDIER[unit]
        if low < abs(value) and low <= abs(value) < high:
            value, unit = factor * value, handier
    return f"{plain(value)} {sign(unit)}".strip()


def in_suitable_unit(value: float, sigma: float | None, unit: str) -> str:
    """Return a value with its uncertainty in a suitable unit: ``5.3 ± 1.6 mm``."""
    low, high, handier, factor = _HANDIER.get(unit, (math.inf, math.inf, unit, 1.0))
    if low < abs(value) < high:
        return with_uncertainty(value * factor, None if sigma is None else sigma * factor, handier)
    return with_uncertainty(value, sigma, unit)


def two_decimals(value: float) -> str:
    """Return two decimals, ``13.35``, or three significant digits of small numbers: ``0.0299``."""
    return f"{value:.2f}" if abs(value) >= 1.0 or not math.isfinite(value) else plain(value)


def in_one_unit(values: Sequence[float | None], unit: str) -> list[str]:
    """Return numbers of one kind in the unit that suits the first: ``10.0 µm``, ``4.83 µm``, ``0 µm``."""
    first = quantity(values[0], unit)
    factor, handier = 1.0, sign(unit)
    if unit in _HANDIER and first.endswith(sign(_HANDIER[unit][2])):
        handier, factor = sign(_HANDIER[unit][2]), _HANDIER[unit][3]
    return ["–" if plain(v) == "–" else f"{plain(factor * (v or 0.0))} {handier}".strip() for v in values]


def sign(unit: str) -> str:
    """Return the printed form of a unit."""
    return _SIGNS.get(unit, unit.replace("N m", "N·m"))


def capitalised(words: str) -> str:
    """Return words with an upper-case first letter."""
    return f"{words[:1].upper()}{words[1:]}"


def printed(sentence: str) -> str:
    """Return a sentence with units, uncertainties and negative numbers in their printed form."""
    sentence = re.sub(r"(?<![\w.+-])-(?=\d)", "−", sentence.replace(" +- ", " ± "))
    sentence = re.sub(r"\bN m\b", "N·m", re.sub(r"\bu(m|rad)\b", r"µ\1", sentence))
    return re.sub(r"(?<=/mm)[23]\b", lambda power: "²³"[int(power[0]) - 2], sentence)


def p_value(p: float | None) -> str:
    """Return the text of a p-value."""
    if p is None or not math.isfinite(p):
        return "–"
    return "< 1e-6" if p < LEAST_PRINTED_P else f"{p:.2g}"


def p_equals(p: float) -> str:
    """Return a p-value with its relation: ``= 0.02``, ``< 1e-6``."""
    return p_value(p) if p < LEAST_PRINTED_P else f"= {p_value(p)}"


def p_at_most(p: float) -> str:
    """Return the bound of a probability in words: ``at most 0.02``, ``below 1e-6``."""
    return f"at most {p:.2g}" if p >= LEAST_PRINTED_P else f"below {p_value(p).removeprefix('< ')}"


def percent(value: float) -> str:
    """Return two significant digits of a percentage, without a power of ten: ``0.19 %``, ``110 %``."""
    if abs(value) >= 99.5:
        return f"{value:.0f} %"
    return f"{value:.2g} %" if value == 0.0 or abs(value) >= 1e-4 else f"{value:.6f} %"


def count_text(n: int, noun: str) -> str:
    """Return a number with its noun: ``1 pose``, ``2 poses``, ``2 bodies``, ``2 entries``, ``2 approaches``."""
    if n == 1:
        return f"{n} {noun}"
    if noun.endswith(("dy", "ry")):
        return f"{n:,} {noun[:-1]}ies"
    return f"{n:,} {noun}{'es' if noun.endswith('ch') else 's'}"


def duration(seconds: float) -> str:
    """Return a duration in a suitable unit."""
    size, unit = _span(seconds)
    return f"{plain(size)} s" if unit == "s" else f"{size:.1f} {unit}"


def approximate_duration(seconds: float) -> str:
    """Return an approximate duration: ``about 20 min``."""
    size, unit = _span(seconds)
    return f"about {rough(size)} {unit}"


def _span(seconds: float) -> tuple[float, str]:
    known = (("days", 172800.0, 86400.0), ("h", 5400.0, 3600.0), ("min", 120.0, 60.0))
    return next(
        ((seconds / seconds_per_unit, unit) for unit, least, seconds_per_unit in known if seconds >= least),
        (seconds, "s"),
    )


def listed(names: Sequence[str], most: int = 8) -> str:
    """Return the first names, and the number of the others."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def joined_names(names: Sequence[str]) -> str:
    """Return names as an enumeration: ``a``, ``a and b``, ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1]))) if names else ""


def reasons(noun: str, *left_out: Mapping[tuple[str, str], int]) -> list[str]:
    """Return the number of exclusions by reason, the most frequent first; given by (file, reason)."""
    total: Counter[str] = Counter()
    for counts in left_out:
        for (_, reason), number in counts.items():
            total[reason] += number
    return [f"{count_text(number, noun)}: {reason}" for reason, number in total.most_common()]


def gross_errors(number: int, noun: str) -> str:
    """Return ``1 reading as a gross error``, ``2 readings as gross errors``, for the exclusions of a stage."""
    return f"{count_text(number, noun)} as {'a gross error' if number == 1 else 'gross errors'}"
