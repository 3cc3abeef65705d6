"""What lies in folders of photographs and is not read: pictures in other formats, pipes, and whatever else."""

from __future__ import annotations

import os
import stat
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from truing.formats.source import PICTURES

# Pictures as cameras, phones and programs write them; none is read, for it would need each maker's own decoder, or
# because it was compressed for looking at and no longer holds where an edge is.
_COMPRESSED = ("heic", "heif", "hif", "avif", "webp", "jxl", "jp2", "j2k")
_OF_PROGRAMS = ("gif", "bmp", "ppm", "pgm", "pnm", "tga", "psd", "exr")
_OF_SENSORS = (
    *("dng", "cr2", "cr3", "crw", "nef", "nrw", "arw", "srf", "sr2", "orf", "rw2", "raf", "pef", "srw", "x3f", "iiq"),
    *("3fr", "fff", "mrw", "dcr", "kdc", "rwl", "raw"),
)
_OTHER_PICTURES = frozenset((*_COMPRESSED, *_OF_PROGRAMS, *_OF_SENSORS))
_DEEPEST = 3  # images/<pose>/<camera>/<file>
_READ = ", ".join(f".{ending}" for ending in PICTURES)


@dataclass(frozen=True)
class PassedOver:
    """A file that is not read: its name as campaign.toml reaches it, and why; is_fault: a photograph is missed."""

    name: str
    why: str
    is_fault: bool = False

    @property
    def folder(self) -> str:
        """The folder that it lies in."""
        return PurePosixPath(self.name).parent.as_posix()


def passed_over(root: Path, folders: Collection[str], read: Collection[str]) -> Iterator[PassedOver]:
    """Yield everything in folders (names below ``root``) of photographs that is not among those read.

    A picture in another format beside one that is read and has its name is that camera's raw data, and is no loss.
    """
    stems = {os.path.splitext(name)[0] for name in read}
    for name in _below(root, folders):
        if name not in read and not PurePosixPath(name).name.startswith("."):
            yield why_not_read(root / name, name, stems)


def _below(root: Path, folders: Collection[str]) -> Iterator[str]:
    for folder in dict.fromkeys(folders):
        top = (root / folder).as_posix()
        for place, inner, files in os.walk(top, followlinks=True):
            depth = len(Path(place).relative_to(top).parts)
            inner[:] = sorted(name for name in inner if not name.startswith(".")) if depth < _DEEPEST else []
            below = PurePosixPath(folder, *Path(place).relative_to(top).parts)
            yield from ((below / file).as_posix() for file in sorted(files))


def why_not_read(path: Path, name: str, read_stems: Collection[str]) -> PassedOver:
    """Return why a file is not read, or may not be; read_stems: names without ending of those that are."""
    ending = path.suffix.lower().removeprefix(".")
    is_picture = ending in PICTURES or ending in _OTHER_PICTURES
    kind = _kind(path)
    if kind:
        return PassedOver(name, f"a photograph in a regular file; this is {kind}" if is_picture else kind, is_picture)
    if ending in _OTHER_PICTURES and os.path.splitext(name)[0] not in read_stems:
        return PassedOver(name, f"a photograph as JPEG, PNG or TIFF ({_READ}): export it from .{ending}", True)
    if ending in PICTURES:
        return PassedOver(name, _misplaced(path, ending), True)
    return PassedOver(name, f"no photograph (.{ending})" if ending else "no photograph (no ending)")


def _kind(path: Path) -> str:
    """What is no regular file, in words; empty for one that is."""
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return "a link that leads nowhere"
    if stat.S_ISREG(mode):
        return ""
    return "a pipe" if stat.S_ISFIFO(mode) else "a socket or a device"


def _misplaced(path: Path, ending: str) -> str:
    if path.suffix.removeprefix(".") not in (ending, ending.upper()):
        return f"an ending in small or in capital letters, .{ending} or .{ending.upper()}"
    return "a photograph at most two folders down, <pose>/<camera>/<file>, or [files.images] with from_name"
