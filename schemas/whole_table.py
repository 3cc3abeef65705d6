"""A table of a run as Arrow: whole, and what its artifact's schema says."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from truing.schemas.artifact import Artifact
from truing.schemas.memory import raise_shortage

if TYPE_CHECKING:
    import pyarrow as pa


def whole_table(path: Path, artifact: Artifact) -> pa.Table:
    """Return the table in a Parquet file; raises ValueError with everything in which it is not this artifact."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
        table.validate(full=True)
        faults = artifact.faults(table)
    except (pa.ArrowException, UnicodeError) as error:
        raise_shortage(error)
        raise ValueError(f"{artifact.file}: expected a whole Parquet file ({_first_line(error)})") from None
    except OSError as error:
        if error.errno:  # not of the file's bytes, but of reaching them
            raise
        raise ValueError(f"{artifact.file}: expected a whole Parquet file ({_first_line(error)})") from None
    if faults:
        raise ValueError("\n".join(str(fault) for fault in faults))
    return table


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [""])[0][:200]
