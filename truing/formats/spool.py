"""Columns of whole numbers on disk: more rows than memory should hold, read back in any order, then gone."""

from __future__ import annotations

import tempfile
import weakref
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray


class Spool:
    """Columns of int32 in temporary files in ``folder`` (None: the system's place for such)."""

    def __init__(self, names: tuple[str, ...], folder: Path | None = None) -> None:
        self.rows = 0
        self._files: dict[str, IO[bytes]] = {name: _temporary(name, folder) for name in names}
        self._closed = weakref.finalize(self, _close, tuple(self._files.values()))

    def append(self, **columns: NDArray[np.int32]) -> None:
        """Add rows: every column, all of the same length."""
        for name, values in columns.items():
            self._files[name].write(np.ascontiguousarray(values, dtype=np.int32).data)
        self.rows += len(next(iter(columns.values())))

    def read(self, name: str, start: int, stop: int) -> NDArray[np.int32]:
        """One column's rows from ``start`` to before ``stop``."""
        file = self._files[name]
        values = np.empty(max(min(stop, self.rows) - start, 0), dtype=np.int32)
        file.seek(start * values.itemsize)
        file.readinto(values.data.cast("B"))  # type: ignore[attr-defined]
        file.seek(0, 2)
        return values

    def close(self) -> None:
        """Give the disk space back."""
        self._closed()


def _temporary(name: str, folder: Path | None) -> IO[bytes]:
    return tempfile.TemporaryFile(prefix=f".{name}-", suffix=".part", dir=folder, buffering=0)


def _close(files: tuple[IO[bytes], ...]) -> None:
    for file in files:
        file.close()
