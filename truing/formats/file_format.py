"""File formats of installed packages: presets of instruments, and readers of binary files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

from truing.formats.raw import RawBatch, Wanted
from truing.schemas.installed import with_installed
from truing.schemas.mapping import FORMAT_ENTRY_POINTS, FileMapping


class FileFormat:
    """A file format of a package: name, preset mapping keys, and a reader for binary files.

    ``preset``: keys of [files.<table>] by name; those of campaign.toml have priority. ``is_text``: truing's own reader
    of separated text reads it.
    """

    name: ClassVar[str]
    preset: ClassVar[Mapping[str, object]] = {}
    is_text: ClassVar[bool] = True

    def read(self, path: Path, wanted: Wanted) -> Iterator[RawBatch]:
        """Yield the columns of a file, decompressed at ``path``; raises Unusable for a file that it cannot read."""
        raise NotImplementedError(f"format {self.name}: found no method read, expected one where is_text is False")

    def checked_preset(self) -> Mapping[str, Any]:
        """Return the preset with the types of a mapping; raises pydantic's ValidationError for an unknown key."""
        settled = FileMapping.model_validate({"path": ".", **self.preset})
        return {key: getattr(settled, key) for key in self.preset}


def installed_format(name: str) -> FileFormat | None:
    """Return the format of a name that a package has installed; None if there is none."""
    file_formats: tuple[FileFormat, ...] = ()
    return with_installed(file_formats, FORMAT_ENTRY_POINTS, "file format", lambda file_format: file_format.name).get(
        name
    )
