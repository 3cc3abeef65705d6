"""Memory shortages are distinguished from damaged files and installations."""

from __future__ import annotations

import errno

import pyarrow as pa
import pytest

from truing.schemas.faults import CampaignFaults
from truing.schemas.memory import raise_shortage, shortage_in_chain


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        MemoryError("Unable to allocate 7 GiB"),
        pa.ArrowMemoryError("malloc of size 4000000000 failed"),
        pa.ArrowException("Unknown error: Failed to launch worker thread: Resource temporarily unavailable"),
        ImportError("libarrow.so: failed to map segment from shared object"),
        RuntimeError("can't start new thread"),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
    ],
    ids=repr,
)
def test_want_of_memory_is_recognised_also_behind_another_error(error: Exception) -> None:
    assert shortage_in_chain(error) is error
    with pytest.raises(MemoryError):
        raise_shortage(error)
    hidden = CampaignFaults([])
    hidden.__context__ = error  # as of one raised while the other was handled
    assert shortage_in_chain(hidden) is error


@pytest.mark.parametrize(
    "error",
    [
        ValueError("cannot allocate memory"),  # somebody's words
        pa.ArrowInvalid("Parquet magic bytes not found in footer"),
        pa.ArrowMemoryError("malloc of size 9223372036854775807 failed"),  # a damaged file asks for it
        ImportError("No module named 'ezc3d'"),
        FileNotFoundError(errno.ENOENT, "failed to map segment"),
    ],
    ids=repr,
)
def test_other_errors_are_not_taken_for_lack_of_memory(error: Exception) -> None:
    assert shortage_in_chain(error) is None
    raise_shortage(error)
