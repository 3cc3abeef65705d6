"""Messages about bad input: one line per fault, all faults together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace

_LONGEST = {
    "place": 160,
    "value": 120,
    "expected": 1000,
}  # characters

_FILES_SHOWN = 3  # with the same fault; more of them are counted


class Unfit(ValueError):
    """A quantity with an impossible value: ``what`` it is, the value found, and the expectation."""

    def __init__(self, what: str, actual: str, expected: str) -> None:
        super().__init__(f"{what}: found {actual}, expected {expected}")
        self.what, self.found, self.expected = what, actual, expected


@dataclass(frozen=True)
class Fault:
    """One fault of an input: place, value found and value expected.

    ``row`` is the line of the file as an editor counts it (the header is line 1); or the row of a binary table from 1.
    ``more`` counts further faults of the same kind that are not listed, ``more_files`` the further files that contain
    them.
    """

    file: str
    expected: str
    row: int | None = None
    column: str | None = None
    value: str | None = None
    more: int = 0
    more_files: int = 0

    @property
    def is_of_key(self) -> bool:
        """True if ``column`` is the key of a settings file."""
        return self.file.endswith(".toml")

    def facts(self) -> dict[str, object]:
        """All fields by name, and ``key`` in addition: the key of a settings file, None for a table."""
        return {**asdict(self), "key": self.column if self.is_of_key else None}

    def __str__(self) -> str:
        where = _one_line(self.file, 4 * _LONGEST["place"])
        if self.row is not None:
            where += f", row {self.row}"
        if self.column:
            what = "key" if self.is_of_key else "column"
            where += f", {what} {_one_line(self.column, _LONGEST['place'])}"
        found_words = "" if self.value is None else f"found {_shortened(self.value, _LONGEST['value'])!r}; "
        within = f", in {self.more_files} other files" if self.more_files else ""
        more = f" (and {self.more} more like it{within})" if self.more else ""
        return f"{where}: {found_words}expected {_one_line(self.expected, _LONGEST['expected'])}{more}"


def first_line(error: BaseException) -> str:
    """First line of an error's text; empty without one."""
    return (str(error).splitlines() or [""])[0]


def _one_line(text: str, longest: int) -> str:
    """A text on one line, with control characters escaped for the terminal."""
    text = _shortened(" ".join(text.split("\n")), longest)
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def _shortened(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[: longest - 24]} ... {text[-12:]}"


def by_kind(faults: Iterable[Fault]) -> Iterator[Fault]:
    """Yield the faults; one that many files share is reported once, with their number."""
    listed = list(faults)
    alike: dict[tuple[str | None, str], list[Fault]] = {}
    for fault in listed:
        alike.setdefault((fault.column, fault.expected), []).append(fault)
    for fault in listed:
        same = alike[fault.column, fault.expected]
        files = len({one.file for one in same})
        if files <= _FILES_SHOWN:
            yield fault
        elif fault is same[0]:
            yield replace(fault, more=sum(1 + one.more for one in same) - 1, more_files=files - 1)


class CampaignFaults(Exception):
    """All faults of a campaign that cannot be used."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(by_kind(faults))
        super().__init__("\n".join(str(fault) for fault in self.faults))
