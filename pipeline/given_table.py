"""Tables that the command line names: read as they are, with a fault where that cannot be."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.memory import raise_shortage
from truing.schemas.settings_text import regular_size

if TYPE_CHECKING:
    import pyarrow as pa

ENDINGS = (".csv", ".parquet")


def read_given(path: Path, what: str) -> pa.Table:
    """Return the table in a .csv or .parquet file; raises CampaignFaults where there is none."""
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    if path.suffix not in ENDINGS:
        raise CampaignFaults([Fault(str(path), f"{what}, .csv or .parquet")])
    try:
        regular_size(path)  # a pipe would be waited for without end
        table = pa.parquet.read_table(path) if path.suffix == ".parquet" else pa.csv.read_csv(path)
        table.validate(full=True)
        names = table.column_names  # raises where one is no text
    except FileNotFoundError:
        raise CampaignFaults([Fault(str(path), "a file that exists")]) from None
    except (pa.ArrowException, OSError, UnicodeError) as error:
        raise_shortage(error)
        if isinstance(error, OSError) and error.errno:  # the environment's
            raise
        raise CampaignFaults([Fault(str(path), f"a table that can be read ({error})")]) from None
    twice = sorted(name for name, times in Counter(names).items() if times > 1)
    if twice:
        raise CampaignFaults(Fault(str(path), "one column of that name", column=name) for name in twice)
    return table


def table_bytes(table: pa.Table, ending: str, quoting: Literal["none", "needed"] = "none") -> bytes:
    """Return a table as the bytes of a .csv or .parquet file.

    quoting, of a .csv: ``needed`` where text may hold what separates; ``none`` raises pyarrow's ArrowInvalid then.
    """
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    sink = pa.BufferOutputStream()
    if ending == ".parquet":
        pa.parquet.write_table(table, sink)
    else:
        pa.csv.write_csv(table, sink, pa.csv.WriteOptions(quoting_style=quoting))
    return bytes(sink.getvalue())
