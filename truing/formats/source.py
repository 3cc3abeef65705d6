"""Raw files of a campaign: their paths, mappings, and unread files next to photographs; opens none of them."""

from __future__ import annotations

import glob
import os
import re
import stat
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import TYPE_CHECKING

from truing.formats.file_search import TooManyEntries, companion_files, find_files, format_suffix
from truing.schemas.near_names import did_you_mean
from truing.schemas.settings_text import NOTHING_SPECIAL

if TYPE_CHECKING:
    from truing.formats.colmap import Estimate
    from truing.schemas.campaign import Campaign
    from truing.schemas.mapping import FileMapping
    from truing.schemas.stage_cost import StageCost

OF_IMAGES = ("images", "image_points", "image_targets", "scale_bars", "known_points", "cameras")
BY_MAPPING = ("loads", "measured")  # tables that [files] alone can name: such names of files have no meaning
OTHERS = (
    *("points", "poses", "targets", "resurveys", "configurations", "scans", "surfaces", "distances"),
    *("displacement", "interferometer", "signals", "quadrature", "positioning", "published"),
    *BY_MAPPING,
)
TABLES = (*OTHERS, *OF_IMAGES)
LOGO = "logo"  # the picture of [campaign], which the page holds
_RAYS = ("images", "image_points")  # either of these defines a campaign of photographs
_OF_POINTS = ("points", "poses", "scans", "distances")
PICTURES = ("jpg", "jpeg", "png", "tif", "tiff")
_MEASURED = ("points", "poses", "distances")
_COORDINATES = "[xyz]_mm"
_BY_CHANNEL = "interferometer"  # table whose rows may be side by side, one column per channel
# Formats of pictures that are not read: they need the decoder of each maker, or have lossy compression that no longer
# shows where an edge is.
_COMPRESSED = ("heic", "heif", "hif", "avif", "webp", "jxl", "jp2", "j2k")
_OF_PROGRAMS = ("gif", "bmp", "ppm", "pgm", "pnm", "tga", "psd", "exr")
_OF_SENSORS = (
    *("dng", "cr2", "cr3", "crw", "nef", "nrw", "arw", "srf", "sr2", "orf", "rw2", "raf", "pef", "srw", "x3f", "iiq"),
    *("3fr", "fff", "mrw", "dcr", "kdc", "rwl", "raw"),
)
_OTHER_PICTURES = frozenset((*_COMPRESSED, *_OF_PROGRAMS, *_OF_SENSORS))
_FILES_OF_MECHANISM = ("model", "compliance_file", "deformation_file", "urdf")
NO_DIGESTS: Mapping[str, str] = MappingProxyType({})
_DEEPEST = 3  # images/<pose>/<camera>/<file>
_READ = ", ".join(f".{ending}" for ending in PICTURES)


@dataclass(frozen=True)
class RawFile:
    """One raw file: its name as reached from campaign.toml, and its path."""

    name: str
    path: Path

    @property
    def suffix(self) -> str:
        """Ending that determines the format, without that of a compression: ``.csv`` of ``points.csv.gz``."""
        return format_suffix(self.path)


class CampaignFiles:
    """Raw files of one campaign, from its folder and its [files]; ``scratch``: folder for temporary files.

    ``digests``: SHA-256 of the files that a stage depends on, by name; empty where nobody computed them. ``costs``:
    what stages took, for the page.
    """

    costs: tuple[StageCost, ...] = ()

    def __init__(
        self, folder: Path, campaign: Campaign, scratch: Path | None = None, digests: Mapping[str, str] = NO_DIGESTS
    ) -> None:
        self.folder, self.scratch, self.digests = folder, scratch, digests
        self.estimate: Estimate | None = None  # of covariances, for adjusted points without any
        self._files = campaign.files
        self._prior_model = getattr(campaign.mechanism, "model", None)
        self._compliance = getattr(campaign.mechanism, "compliance_file", None)
        self._deformation = getattr(campaign.mechanism, "deformation_file", None)
        self._urdf = getattr(campaign.mechanism, "urdf", None)

    def entries(self, table: str) -> tuple[FileMapping, ...]:
        """Return the mappings of a table's raw files: those of [files.<table>], else the contract's file names."""
        mapped = self._files.get(table)
        if mapped is not None:
            entries = mapped if isinstance(mapped, tuple) else (mapped,)
            if table == "images":
                return tuple(_with_pictures_of_folders(self.folder, entry) for entry in entries)
            if table == "configurations":
                return tuple(_without_measured(entry, self._files) for entry in entries)
            return (
                tuple(channel_entry for entry in entries for channel_entry in entry.by_channel)
                if table == _BY_CHANNEL
                else entries
            )
        from truing.schemas.mapping import FileMapping

        if table == "images":
            patterns = tuple(name for name in _contract_names(table) if _expand(self.folder, name))
            return (FileMapping(path=patterns),) if patterns else ()
        # A dangling link (a missing drive) does not mean that the campaign has no such table.
        present = [name for name in _contract_names(table) if os.path.lexists(self.folder / name)]
        if table == "poses":  # other tables used this file name before it had a meaning
            present = [name for name in present if not self._is_of_another_table(name)]
        return tuple(FileMapping(path=name) for name in present)

    def _is_of_another_table(self, name: str) -> bool:
        """True if campaign.toml assigns a file of the folder to some table."""
        return name in self.names_in_entries

    @property
    def names_in_entries(self) -> frozenset[str]:
        """Files that the entries of campaign.toml find, as reached from the folder."""
        patterns = [pattern for mapped in self._files.values() for entry in mapped for pattern in entry.paths]
        return frozenset(name for pattern in patterns for name in _expand(self.folder, pattern))

    @property
    def has_photographs(self) -> bool:
        """True if points come from photographs, or from rays measured in them."""
        return _has_photographs(self.folder, self._files)

    @property
    def folders_of_photographs(self) -> tuple[str, ...]:
        """Folders in which every picture counts: those that [files.images] names as such, else images."""
        mapped = self._files.get("images")
        if mapped is None:
            return ("images",)
        paths = (path for entry in mapped for path in entry.paths)
        return tuple(path.rstrip("/") for path in paths if os.path.isdir(self.folder / path))

    def is_mapped(self, table: str) -> bool:
        """True if campaign.toml has a mapping for a table."""
        return table in self._files

    def resolve(self, pattern: str) -> tuple[RawFile, ...]:
        """Return the files of a path or glob of campaign.toml, ``pose2`` before ``pose10``."""
        return tuple(RawFile(name, self.folder / name) for name in _expand(self.folder, pattern))

    def why_nothing(self, pattern: str) -> str:
        """Return the expectation for a pattern without files."""
        try:
            find_files(self.folder, pattern)
        except TooManyEntries as error:
            return error.expected
        is_there = "\0" not in pattern and os.path.lexists(self.folder / pattern)
        if is_there:
            return f"a regular file: {NOTHING_SPECIAL}"
        folder = (self.folder / pattern).parent if "\0" not in pattern else self.folder
        names = sorted(os.listdir(folder)) if folder.is_dir() and folder.is_relative_to(self.folder) else []
        return f"an existing file{did_you_mean(Path(pattern).name, names)}"

    def is_outside(self, raw: RawFile) -> bool:
        """True if a file is outside the campaign's folder, also through a link."""
        return not raw.path.resolve().is_relative_to(self.folder.resolve())

    @property
    def prior_model(self) -> RawFile | None:
        """Return the model of an earlier campaign that this one starts from; None without one."""
        return None if self._prior_model is None else RawFile(self._prior_model, self.folder / self._prior_model)

    @property
    def compliance(self) -> RawFile | None:
        """Return the file of the simulated compliance; None if campaign.toml names none."""
        return None if self._compliance is None else RawFile(self._compliance, self.folder / self._compliance)

    @property
    def deformation(self) -> RawFile | None:
        """Return the file of the simulated deformation; None if campaign.toml names none."""
        return None if self._deformation is None else RawFile(self._deformation, self.folder / self._deformation)

    @property
    def urdf(self) -> RawFile | None:
        """Return the robot description; None if campaign.toml names none."""
        return None if self._urdf is None else RawFile(self._urdf, self.folder / self._urdf)


def has_photographs(folder: Path, document: Mapping[str, object]) -> bool:
    """True if a campaign's points come from photographs; the parsed campaign.toml need not be valid."""
    return _has_photographs(folder, _mapped(document))


def _has_photographs(folder: Path, mapped: Mapping[str, object]) -> bool:
    """True if [files] maps photographs or rays; else if such files exist, and no points that replace
    them."""
    if any(table in mapped for table in _RAYS):
        return True
    if any(table in mapped or _exists(folder, table) for table in _OF_POINTS):
        return False
    return any(_exists(folder, table) for table in _RAYS)


def _exists(folder: Path, table: str) -> bool:
    if table == "images":
        return any(_expand(folder, name) for name in _contract_names(table))
    return any(os.path.lexists(folder / name) for name in _contract_names(table))


def raw_files(folder: Path, document: Mapping[str, object], tables: tuple[str, ...] | None = None) -> tuple[Path, ...]:
    """Return every existing raw file that these tables need (None: all tables, and files of [mechanism]); the parsed
    campaign.toml need not be valid."""
    mapped = _mapped(document)
    named = [table for table in TABLES if tables is None or table in tables]
    patterns = [name for table in named if table not in mapped for name in _contract_names(table)]
    for table, entry in mapped.items():
        if tables is None or table in tables or (table not in TABLES and "points" in tables):
            named_here = _patterns(entry)
            patterns += _pictures_of_folders(folder, named_here) if table == "images" else named_here
    if tables is None or "points" in tables:
        patterns += _files_of_mechanism(document)
    if tables is None or LOGO in tables:
        patterns += _logo(document)
    named_files = {folder / name for pattern in patterns for name in _expand(folder, pattern)}
    return tuple(sorted(named_files.union(*map(companion_files, named_files))))


def _mapped(document: Mapping[str, object]) -> Mapping[str, object]:
    mapped = document.get("files")
    return mapped if isinstance(mapped, Mapping) else {}


def _files_of_mechanism(document: Mapping[str, object]) -> list[str]:
    mechanism = document.get("mechanism")
    named = [mechanism.get(key) for key in _FILES_OF_MECHANISM] if isinstance(mechanism, Mapping) else []
    return [name for name in named if isinstance(name, str)]


def _logo(document: Mapping[str, object]) -> list[str]:
    campaign = document.get("campaign")
    name = campaign.get(LOGO) if isinstance(campaign, Mapping) else None
    return [name] if isinstance(name, str) and name else []


def _patterns(entry: object) -> list[str]:
    if isinstance(entry, Mapping):
        entry = entry.get("path")
    if isinstance(entry, str):
        return [entry]
    return [name for part in entry for name in _patterns(part)] if isinstance(entry, list | tuple) else []


def _without_measured(entry: FileMapping, files: Mapping[str, object]) -> FileMapping:
    """Return an entry of configurations that passes over columns of its file which another entry reads as measured.

    What was measured is no condition that an effect may depend on.
    """
    from truing.formats.mapping import names_of_template

    patterns = [entry.ignore] if entry.ignore is not None else []
    for table in _MEASURED:
        mapped = files.get(table, ())
        for other in mapped if isinstance(mapped, tuple) else (mapped,):
            if set(other.paths) != set(entry.paths):
                continue
            sources = (other.reference(name) for name in other.columns if name not in entry.columns)
            patterns += [_COORDINATES, *(re.escape(name) for name in sources if isinstance(name, str))]
            patterns += [names_of_template(other.wide)] if other.wide is not None else []
    return entry.model_copy(update={"ignore": "|".join(patterns)}) if patterns else entry


def _contract_names(table: str) -> tuple[str, ...]:
    if table in BY_MAPPING:
        return ()
    return _pictures_in("images") if table == "images" else (f"{table}.csv", f"{table}.parquet")


def _pictures_in(folder: str) -> tuple[str, ...]:
    """Return the globs of pictures in a folder and two levels below."""
    endings = [ending for name in PICTURES for ending in (name, name.upper())]
    return tuple(f"{glob.escape(folder)}/{inner}*.{ending}" for inner in ("", "*/", "*/*/") for ending in endings)


def _pictures_of_folders(folder: Path, patterns: Iterable[str]) -> list[str]:
    """Return patterns of [files.images] with folders replaced by globs of their pictures."""
    pictures: list[str] = []
    for pattern in patterns:
        globs = _pictures_in(pattern.rstrip("/")) if os.path.isdir(folder / pattern) else ()
        pictures += [picture for picture in globs if _expand(folder, picture)] or [pattern]
    return pictures


def _with_pictures_of_folders(folder: Path, entry: FileMapping) -> FileMapping:
    return entry.model_copy(update={"path": tuple(_pictures_of_folders(folder, entry.paths))})


def _expand(folder: Path, pattern: str) -> list[str]:
    """Return the files of a pattern; none if it visits too many, which is reported on reading."""
    try:
        return find_files(folder, pattern)
    except TooManyEntries:
        return []


@dataclass(frozen=True)
class SkippedFile:
    """A file that is not read: its name as reached from campaign.toml, and the reason; is_fault: a photograph is
    missing."""

    name: str
    why: str
    is_fault: bool = False

    @property
    def folder(self) -> str:
        """Folder of the file."""
        return PurePosixPath(self.name).parent.as_posix()


def skipped_files(root: Path, folders: Collection[str], read: Collection[str]) -> Iterator[SkippedFile]:
    """Yield all files in folders (names below ``root``) of photographs that are not read.

    A picture in another format next to a read one of the same name is that camera's raw data, and is not missing.
    """
    stems = {os.path.splitext(name)[0] for name in read}
    for name in _files_below(root, folders):
        if name not in read and not PurePosixPath(name).name.startswith("."):
            yield why_not_read(root / name, name, stems)


def _files_below(root: Path, folders: Collection[str]) -> Iterator[str]:
    for folder in dict.fromkeys(folders):
        top = (root / folder).as_posix()
        for path, inner, files in os.walk(top, followlinks=True):
            depth = len(Path(path).relative_to(top).parts)
            inner[:] = sorted(name for name in inner if not name.startswith(".")) if depth < _DEEPEST else []
            below = PurePosixPath(folder, *Path(path).relative_to(top).parts)
            yield from ((below / file).as_posix() for file in sorted(files))


def why_not_read(path: Path, name: str, read_stems: Collection[str]) -> SkippedFile:
    """Return the reason for not reading a file; read_stems: names without ending of files that are read."""
    ending = path.suffix.lower().removeprefix(".")
    is_picture = ending in PICTURES or ending in _OTHER_PICTURES
    kind = _kind(path)
    if kind:
        return SkippedFile(name, f"a photograph in a regular file; this is {kind}" if is_picture else kind, is_picture)
    if ending in _OTHER_PICTURES and os.path.splitext(name)[0] not in read_stems:
        return SkippedFile(name, f"a photograph as JPEG, PNG or TIFF ({_READ}): export it from .{ending}", True)
    if ending in PICTURES:
        return SkippedFile(name, _misplaced(path, ending), True)
    return SkippedFile(name, f"no photograph (.{ending})" if ending else "no photograph (no ending)")


def _kind(path: Path) -> str:
    """Return the kind of a file that is not regular, in words; empty for a regular one."""
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
