"""Whether a campaign says what to calibrate with: poses of role reference alone calibrate nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from truing.formats.faultlog import FaultLog
from truing.schemas.faults import Fault

if TYPE_CHECKING:
    import pyarrow as pa

FITTED, REFERENCE = "calibration", "reference"


def check_any_fitted(tables: Sequence[pa.Table], file: str, what: str, log: FaultLog) -> None:
    """A fault where every row is a reference; what: pose or run.

    A campaign of role verification alone tests an earlier model, and a short one may fit to its reference poses.
    """
    roles: Counter[str] = Counter()
    for table in tables:
        if "role" in table.column_names:
            roles.update(filter(None, table.column("role").to_pylist()))
        elif len(table):
            return
    if set(roles) == {REFERENCE}:
        expected = f"at least one {what} of role {FITTED}: without one there is nothing to fit to"
        log.add(Fault(file, expected, column="role", value=f"{', '.join(roles)} alone"))
