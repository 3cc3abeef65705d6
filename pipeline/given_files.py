"""Files named in a call: tables to read, and output paths that are neither raw files nor files of a run."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from truing.pipeline.atomic_file import write_atomically
from truing.pipeline.campaign_folder import FILE, CampaignFolder, open_campaign
from truing.pipeline.problems import environment
from truing.pipeline.run_folder import PRIVATE
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.memory import raise_shortage
from truing.schemas.settings_text import regular_size

ENDINGS = (".csv", ".parquet")

_OPTION = "--out"


def read_given(path: Path, what: str) -> pa.Table:
    """Return the table in a .csv or .parquet file; raises CampaignFaults."""
    if path.suffix not in ENDINGS:
        raise CampaignFaults([Fault(str(path), f"{what}, .csv or .parquet")])
    try:
        regular_size(path)  # reading a pipe could block for ever
        table = pa.parquet.read_table(path) if path.suffix == ".parquet" else pa.csv.read_csv(path)
        table.validate(full=True)
        names = table.column_names  # raises if one is not text
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

    quoting, for .csv: ``needed`` if text may contain separators; ``none`` then raises pyarrow's ArrowInvalid.
    """
    sink = pa.BufferOutputStream()
    if ending == ".parquet":
        pa.parquet.write_table(table, sink)
    else:
        pa.csv.write_csv(table, sink, pa.csv.WriteOptions(quoting_style=quoting))
    return bytes(sink.getvalue())


def leave_tables(file: Path, tables: Mapping[str, pa.Table], page: str) -> list[Path]:
    """Write tables next to ``file``, with its name and the given endings, and a page; returns the files in order.

    Raises EnvironmentProblem.
    """
    with environment(f"{file.parent} cannot be created"):
        file.parent.mkdir(parents=True, exist_ok=True)
    written = {file.with_name(f"{file.stem}{ending}{file.suffix}"): table for ending, table in tables.items()}
    for path, table in written.items():
        write_atomically(path, table_bytes(table, file.suffix, quoting="needed"))
    write_atomically(file.with_suffix(".html"), page.encode())
    return [*written, file.with_suffix(".html")]


def check_file(path: Path | None, *, reads: Sequence[Path | None] = (), campaign: CampaignFolder | None = None) -> None:
    """Raise CampaignFaults if an output file is no table, or must not be overwritten."""
    if path is not None and (why := next(_file_objections(path, reads, campaign), None)):
        raise CampaignFaults([Fault(_OPTION, why, value=str(path))])


def _file_objections(path: Path, reads: Sequence[Path | None], campaign: CampaignFolder | None) -> Iterator[str]:
    if path.suffix not in ENDINGS:
        yield "a file that ends in .csv or .parquet"
    if path.is_dir():
        yield "a file to write, not a folder"
    if any(_is_same_folder(path, read) for read in reads if read is not None):
        yield "a file that this call does not read"
    if (campaign is not None and _is_raw(path, campaign)) or _is_raw_file(path):
        yield "a file that is no raw file of a campaign; remove it first if it contains no measurements"
    if (path.parent / PRIVATE).is_dir() and path.name in {artifact.file for artifact in ARTIFACTS.values()}:
        yield "a file that is not part of a run"


def check_folder(path: Path) -> None:
    """Raise CampaignFaults if an output folder is a campaign's."""
    if os.path.lexists(path / FILE):
        raise CampaignFaults([Fault(_OPTION, "a folder that holds no campaign", value=str(path))])


def _is_same_folder(path: Path, other: Path) -> bool:
    return os.path.realpath(path) == os.path.realpath(other)


def _is_raw_file(path: Path) -> bool:
    """True if the campaign in the same folder reads a file; True if its campaign.toml cannot be read."""
    if not path.exists() or not os.path.lexists(path.parent / FILE):
        return False
    try:
        return _is_raw(path, open_campaign(path.parent))
    except CampaignFaults:
        return True


def _is_raw(path: Path, campaign: CampaignFolder) -> bool:
    from truing.formats.source import raw_files

    return any(_is_same_folder(path, raw) for raw in raw_files(campaign.folder, campaign.document))
