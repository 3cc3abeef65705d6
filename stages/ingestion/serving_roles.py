"""Whether a campaign says what to calibrate with: poses of role reference alone calibrate nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from schemas.faults import Fault
from truing.formats.faultlog import FaultLog

if TYPE_CHECKING:
    import pyarrow as pa

FITTED, REFERENCE = "calibration", "reference"


def check_any_fitted(tables: Sequence[pa.Table], file: str, what: str, log: FaultLog) -> None:
    """A fault where rows are a reference and none is there to be fitted to; what: pose or run.

    A campaign of role verification alone is one that tests an earlier model.
    """
    roles: Counter[str] = Counter()
    for table in tables:
        if "role" in table.column_names:
            roles.update(filter(None, table.column("role").to_pylist()))
        elif len(table):
            return
    if REFERENCE in roles and FITTED not in roles:
        expected = f"at least one {what} of role {FITTED}: without one there is nothing to fit to"
        log.add(Fault(file, expected, column="role", value=f"{', '.join(roles)} alone"))
