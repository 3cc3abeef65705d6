"""Photographs of a campaign: their files, poses and cameras."""

from __future__ import annotations

import filecmp
import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath

from truing.formats.faultlog import FaultLog
from truing.formats.image_files import ImageHeader, read_head
from truing.formats.patterns import TooSlow, bounded
from truing.formats.raw import Unusable
from truing.formats.source import PICTURES, CampaignFiles, RawFile, SkippedFile, skipped_files, why_not_read
from truing.schemas.faults import Fault
from truing.schemas.mapping import FileMapping

_COLUMN = "files.images"
_KEYS = {"path", "from_name", "constants", "rename", "offset"}
_GROUPS = {"pose", "camera", "image"}
_POSE_IN_NAME = re.compile(r"(?P<pose>.+)_\d+")
_WANTED = "a pose in its name: images/<pose>/<file>, images/<pose>_<number>.jpg, or from_name in [files.images]"
_ENDINGS = tuple(f".{ending}" for ending in PICTURES)
_KINDS = ", ".join(_ENDINGS)
_FOLDER = "images/"
_FINGERPRINT = 256  # bytes


@dataclass(frozen=True)
class Photograph:
    """One photograph: its name in the run, pose and camera (as text), file and header."""

    image: str
    pose: str
    camera: str
    file: RawFile
    head: ImageHeader


@dataclass
class PhotographFiles:
    """Photographs in the order of poses and names; numbers of other files in their folders, by (folder, reason)."""

    found: list[Photograph] = field(default_factory=list)
    left_out: Counter[tuple[str, str]] = field(default_factory=Counter)

    @property
    def poses_are_numbers(self) -> bool:
        """True if every pose is an integer."""
        return all(re.fullmatch(r"[+-]?\d{1,18}", photo.pose) for photo in self.found)


def list_photographs(source: CampaignFiles, sensor_width_mm: float | None, log: FaultLog) -> PhotographFiles:
    """Return all photographs of the campaign with headers; a faulty one is reported in ``log`` and omitted."""
    files, seen = PhotographFiles(), set[RawFile]()
    for entry in source.entries("images"):
        for fault in _faults_of_entry(entry):
            log.add(fault)
        for pattern in entry.paths:
            for raw in _files(source, pattern, files, log):
                if raw in seen:  # two patterns may match the same file
                    continue
                seen.add(raw)
                if (photograph := _photograph(raw, pattern, entry, sensor_width_mm, log)) is not None:
                    files.found.append(photograph)
    for other in skipped_files(source.folder, source.folders_of_photographs, {raw.name for raw in seen}):
        _note_unread(other, files, log)
    _check_names(files.found, log)
    files.found = _with_camera_names(_without_copies(files, log))
    return files


def _note_unread(skipped_file: SkippedFile, collected: PhotographFiles, log: FaultLog) -> None:
    """Report a file that is meant as a photograph but not read; count all others."""
    if skipped_file.is_fault:
        log.add(Fault(skipped_file.name, skipped_file.why))
    else:
        collected.left_out[(skipped_file.folder, skipped_file.why)] += 1


def _faults_of_entry(entry: FileMapping) -> Iterator[Fault]:
    for key in sorted(entry.model_fields_set - _KEYS):
        yield Fault("campaign.toml", f"one of {', '.join(sorted(_KEYS))}", column=f"{_COLUMN}.{key}")
    named = {*bounded(entry.from_name or "", "from_name").groupindex, *entry.constants, *entry.rename, *entry.offset}
    for name in sorted(named - _GROUPS):
        yield Fault("campaign.toml", f"one of {', '.join(sorted(_GROUPS))}", column=_COLUMN, value=name)


def _files(source: CampaignFiles, pattern: str, collected: PhotographFiles, log: FaultLog) -> Iterator[RawFile]:
    """Yield the files of a pattern with the ending of a photograph; other files of a folder are counted."""
    files = source.resolve(pattern)
    photographs = [raw for raw in files if raw.path.suffix.lower() in _ENDINGS]
    if not files:
        log.add(Fault("campaign.toml", source.why_nothing(pattern), column=f"{_COLUMN}.path", value=pattern))
    elif not photographs:
        log.add(Fault(files[0].name, f"a photograph ({_KINDS}): no other file is there", value=pattern))
    stems = {os.path.splitext(raw.name)[0] for raw in photographs}
    for raw in sorted(set(files) - set(photographs), key=lambda raw: raw.name):
        _note_unread(why_not_read(raw.path, raw.name, stems), collected, log)
    yield from photographs


def _photograph(
    raw: RawFile, pattern: str, entry: FileMapping, sensor_width_mm: float | None, log: FaultLog
) -> Photograph | None:
    try:
        reported = _fields_from_name(raw, pattern, entry)
    except TooSlow as error:
        log.add(Fault("campaign.toml", error.expected, column=f"{_COLUMN}.{error.key}", value=error.text))
        return None
    if reported.get("pose") is None:
        wanted = _WANTED if entry.from_name is None else f"a name that matches {entry.from_name} and gives the pose"
        log.add(Fault(raw.name, wanted))
    try:
        head = read_head(raw.path, sensor_width_mm)
    except Unusable as error:
        log.add(Fault(raw.name, error.expected, error.row, error.column, error.value))
        return None
    except OSError as error:
        log.add(Fault(raw.name, "a file that can be read", value=os.strerror(error.errno or 0)))
        return None
    if reported.get("pose") is None:
        return None
    camera = reported.get("camera") or " ".join(part for part in (head.model, head.serial) if part) or "camera"
    image = reported.get("image") or _name(raw)
    return Photograph(image, reported["pose"], camera, raw, head)


def _name(raw: RawFile) -> str:
    """Return a photograph's name: its path in campaign.toml, without ending and default folder."""
    return PurePosixPath(raw.name).with_suffix("").as_posix().removeprefix(_FOLDER)


def _fields_from_name(raw: RawFile, pattern: str, entry: FileMapping) -> dict[str, str]:
    """Return the fields given by constants, from_name or common naming: pose, camera, image."""
    reported: dict[str, str] = {}
    if entry.from_name is None:
        reported = _usual(raw.name[len(_fixed(pattern)) :])
    else:
        name = raw.name if "/" in entry.from_name else raw.name.rsplit("/", 1)[-1]
        match = bounded(entry.from_name, "from_name").search(name)
        reported = {key: text for key, text in match.groupdict().items() if text} if match else {}
    reported |= {key: str(value) for key, value in entry.constants.items()}
    return {key: _renamed(key, value, entry) for key, value in reported.items()}


def _renamed(key: str, value: str, entry: FileMapping) -> str:
    for expression, name in entry.rename.get(key, {}).items():
        if match := bounded(expression, f"rename.{key}").fullmatch(value):
            value = match.expand(name)
            break
    return str(int(value) + entry.offset[key]) if key in entry.offset and re.fullmatch(r"[+-]?\d+", value) else value


def _fixed(pattern: str) -> str:
    """Return the folders of a pattern before its first wildcard."""
    plain = re.split(r"[*?\[]", pattern, maxsplit=1)[0]
    return plain[: plain.rfind("/") + 1]


def _usual(name: str) -> dict[str, str]:
    """Return pose and camera of <pose>/<file>, <pose>/<camera>/<file> or <pose>_<number>.jpg."""
    *folders, file = name.split("/")
    if folders:
        return {"pose": folders[0], **({"camera": "/".join(folders[1:])} if folders[1:] else {})}
    match = _POSE_IN_NAME.fullmatch(file.rsplit(".", 1)[0])
    return {"pose": match["pose"]} if match else {}


def _check_names(photographs: Iterable[Photograph], log: FaultLog) -> None:
    """Report duplicate names, which would count a photograph twice."""
    first: dict[str, RawFile] = {}
    for photograph in photographs:
        if photograph.image in first:
            expected = f"one photograph of each name; {first[photograph.image].name} has it, too"
            log.add(Fault(photograph.file.name, expected, value=photograph.image))
        first.setdefault(photograph.image, photograph.file)


def _without_copies(photographs: PhotographFiles, log: FaultLog) -> list[Photograph]:
    """Return the photographs without identical copies; a copy in another pose is a fault."""
    distinct: list[Photograph] = []
    alike: dict[tuple[int, bytes], list[Photograph]] = defaultdict(list)
    for photo in photographs.found:
        candidates = alike[_fingerprint(photo.file)]
        same = next(
            (candidate for candidate in candidates if filecmp.cmp(candidate.file.path, photo.file.path, shallow=False)),
            None,
        )
        if same is None:
            candidates.append(photo)
            distinct.append(photo)
        elif same.pose == photo.pose:
            photographs.left_out[(photo.file.name, "a copy of another photograph of its pose")] += 1
        else:
            expected = f"a photograph of its own; {same.file.name} of pose {same.pose} is the same"
            log.add(Fault(photo.file.name, expected, value=photo.pose))
    return distinct


def _fingerprint(raw: RawFile) -> tuple[int, bytes]:
    """Return the size of a file and some bytes of its middle, which differ between different photographs."""
    size = raw.path.stat().st_size
    with raw.path.open("rb") as file:
        file.seek(size // 2)
        return size, file.read(_FINGERPRINT)


def _with_camera_names(photographs: list[Photograph]) -> list[Photograph]:
    """Return the photographs with one camera name per format and focal length."""
    formats: dict[str, set[tuple[int, int]]] = defaultdict(set)
    focal: dict[str, set[float | None]] = defaultdict(set)
    for photograph in photographs:
        formats[photograph.camera].add((photograph.head.width_px, photograph.head.height_px))
        focal[photograph.camera].add(photograph.head.focal_mm)

    def name(photo: Photograph) -> str:
        words = [photo.camera]
        if len(focal[photo.camera]) > 1:
            words.append("unknown focal length" if photo.head.focal_mm is None else f"{photo.head.focal_mm:g} mm")
        if len(formats[photo.camera]) > 1:
            words.append(f"{photo.head.width_px} x {photo.head.height_px}")
        return ", ".join(words)

    return [replace(photograph, camera=name(photograph)) for photograph in photographs]
