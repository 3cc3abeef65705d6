"""What a message may show of a raw file: all of one in the campaign's folder, numbers alone of one outside.

A path may lead out of the folder, and so to what its reader never meant to show: a message that is passed on tells
nobody's secrets.
"""

from __future__ import annotations

import re
from dataclasses import replace

from truing.formats.faultlog import CellFaults

_NUMBER = re.compile(r"[-+\d.,' ]{0,30}([eE][-+]?\d{1,3})?|[-+]?(nan|inf)", re.IGNORECASE)
_COUNT = re.compile(r"\d{1,18} (bytes|cells|columns|files|frames|labels|lines|numbers|points|rows|vertices)")
_HIDDEN = "text that is not shown, as the file lies outside the campaign's folder"


def discreet(value: str | None) -> str | None:
    """Return a value from a file outside the campaign's folder as it may be shown."""
    if value is None or _NUMBER.fullmatch(value) or _COUNT.fullmatch(value):
        return value
    return _HIDDEN


def discreet_cells(faults: CellFaults) -> CellFaults:
    """Return faults of cells without their text."""
    return replace(faults, cells=tuple((record, discreet(value)) for record, value in faults.cells))
