"""Formats of times in unknown files, as Python's strptime reads them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime

_DATES = ("%Y-%m-%d", "%Y/%m/%d", "%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y", "%d-%b-%Y", "%d-%m-%Y", "%d.%m.%y")
_CLOCKS = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%H:%M:%S:%f", "%I:%M:%S %p", "%I:%M:%S.%f %p", "%H:%M")
_ZONES = ("", "%z", " %z")  # %z reads Z, +01:00 and +0100
_TURNED = {"%d/%m/%Y": "%m/%d/%Y", "%m/%d/%Y": "%d/%m/%Y"}


@dataclass(frozen=True)
class TimeFormat:
    """A format that reads every cell, and what it assumes beyond the cells (empty: nothing)."""

    form: str
    doubt: str = ""


def time_format_of(cells: Sequence[str]) -> TimeFormat | None:
    """Return the first known format of dates and times of day that reads all cells; None if there is none."""
    texts = [cell.strip() for cell in cells]
    for date, form in _forms():
        if not texts or (times := _read(texts, form)) is None:
            continue
        if not date:
            return TimeFormat(form, "times without a date are assumed to be of one day")
        turned = _TURNED.get(date)
        times_turned = None if turned is None else _read(texts, form.replace(date, turned))
        if times_turned is not None and len({time.date() for time in times}) > 1:
            order = "day/month" if date == "%d/%m/%Y" else "month/day"
            return TimeFormat(form, f"dates such as {texts[0]} are assumed to be {order}")
        return TimeFormat(form)
    return None


def _forms() -> Iterator[tuple[str, str]]:
    """Yield each date (empty: none) with a format."""
    yield "%Y%m%d", "%Y%m%d%H%M%S"
    for clock in _CLOCKS:
        for date in _DATES:
            for between in (" ", "T"):
                yield from ((date, f"{date}{between}{clock}{zone}") for zone in _ZONES)
        yield "", clock


def _read(texts: Sequence[str], form: str) -> list[datetime] | None:
    try:
        return [datetime.strptime(text, form) for text in texts]
    except ValueError:
        return None
