"""The photographs of a campaign: which there are, which pose each belongs to, and which camera took it."""

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
from truing.formats.source import PICTURES, CampaignFiles, RawFile, SkippedFile, passed_over, why_not_read
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
_GLIMPSE = 256  # bytes


@dataclass(frozen=True)
class Photograph:
    """One photograph: its name in the run, pose and camera (as text), its file and its head."""

    image: str
    pose: str
    camera: str
    file: RawFile
    head: ImageHeader


@dataclass
class PhotographFiles:
    """The photographs in the order of poses and names; how many other files lie beside them, by (folder, reason)."""

    found: list[Photograph] = field(default_factory=list)
    left_out: Counter[tuple[str, str]] = field(default_factory=Counter)

    @property
    def poses_are_numbers(self) -> bool:
        """Whether every pose is an integer."""
        return all(re.fullmatch(r"[+-]?\d{1,18}", one.pose) for one in self.found)


def list_photographs(source: CampaignFiles, sensor_width_mm: float | None, log: FaultLog) -> PhotographFiles:
    """Every photograph of the campaign with its head; what is wrong with one goes into ``log``, and it is left out."""
    found, seen = PhotographFiles(), set[RawFile]()
    for entry in source.entries("images"):
        for fault in _faults_of_entry(entry):
            log.add(fault)
        for pattern in entry.paths:
            for raw in _files(source, pattern, found, log):
                if raw in seen:  # two patterns may name the same file
                    continue
                seen.add(raw)
                if (one := _photograph(raw, pattern, entry, sensor_width_mm, log)) is not None:
                    found.found.append(one)
    for other in passed_over(source.folder, source.folders_of_photographs, {raw.name for raw in seen}):
        _note_unread(other, found, log)
    _check_names(found.found, log)
    found.found = _cameras_apart(_once(found, log))
    return found


def _note_unread(one: SkippedFile, found: PhotographFiles, log: FaultLog) -> None:
    """A fault for what was meant as a photograph and is not read; everything else is counted."""
    if one.is_fault:
        log.add(Fault(one.name, one.why))
    else:
        found.left_out[(one.folder, one.why)] += 1


def _faults_of_entry(entry: FileMapping) -> Iterator[Fault]:
    for key in sorted(entry.model_fields_set - _KEYS):
        yield Fault("campaign.toml", f"one of {', '.join(sorted(_KEYS))}", column=f"{_COLUMN}.{key}")
    named = {*bounded(entry.from_name or "", "from_name").groupindex, *entry.constants, *entry.rename, *entry.offset}
    for name in sorted(named - _GROUPS):
        yield Fault("campaign.toml", f"one of {', '.join(sorted(_GROUPS))}", column=_COLUMN, value=name)


def _files(source: CampaignFiles, pattern: str, found: PhotographFiles, log: FaultLog) -> Iterator[RawFile]:
    """The files of a pattern that are photographs by their ending; of a folder's others it is counted how many."""
    files = source.resolve(pattern)
    photographs = [raw for raw in files if raw.path.suffix.lower() in _ENDINGS]
    if not files:
        log.add(Fault("campaign.toml", source.why_nothing(pattern), column=f"{_COLUMN}.path", value=pattern))
    elif not photographs:
        log.add(Fault(files[0].name, f"a photograph ({_KINDS}), as nothing else is found there", value=pattern))
    stems = {os.path.splitext(raw.name)[0] for raw in photographs}
    for raw in sorted(set(files) - set(photographs), key=lambda raw: raw.name):
        _note_unread(why_not_read(raw.path, raw.name, stems), found, log)
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
        wanted = _WANTED if entry.from_name is None else f"a name that matches {entry.from_name} and tells the pose"
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
    """A photograph's name: its file's as campaign.toml reaches it, without ending and without the usual folder."""
    return PurePosixPath(raw.name).with_suffix("").as_posix().removeprefix(_FOLDER)


def _fields_from_name(raw: RawFile, pattern: str, entry: FileMapping) -> dict[str, str]:
    """What constants, from_name or the usual ways of naming tell: pose, camera, image."""
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
    """The folders of a pattern before its first wild card."""
    plain = re.split(r"[*?\[]", pattern, maxsplit=1)[0]
    return plain[: plain.rfind("/") + 1]


def _usual(name: str) -> dict[str, str]:
    """Pose and camera of <pose>/<file>, <pose>/<camera>/<file> or <pose>_<number>.jpg."""
    *folders, file = name.split("/")
    if folders:
        return {"pose": folders[0], **({"camera": "/".join(folders[1:])} if folders[1:] else {})}
    match = _POSE_IN_NAME.fullmatch(file.rsplit(".", 1)[0])
    return {"pose": match["pose"]} if match else {}


def _check_names(found: Iterable[Photograph], log: FaultLog) -> None:
    """The same photograph twice would count twice."""
    first: dict[str, RawFile] = {}
    for one in found:
        if one.image in first:
            expected = f"one photograph of each name; {first[one.image].name} has it, too"
            log.add(Fault(one.file.name, expected, value=one.image))
        first.setdefault(one.image, one.file)


def _once(photographs: PhotographFiles, log: FaultLog) -> list[Photograph]:
    """The photographs without copies: what a picture tells counts once. A copy in another pose is a fault."""
    kept: list[Photograph] = []
    alike: dict[tuple[int, bytes], list[Photograph]] = defaultdict(list)
    for one in photographs.found:
        others = alike[_glimpse(one.file)]
        same = next((other for other in others if filecmp.cmp(other.file.path, one.file.path, shallow=False)), None)
        if same is None:
            others.append(one)
            kept.append(one)
        elif same.pose == one.pose:
            photographs.left_out[(one.file.name, "a copy of another photograph of its pose")] += 1
        else:
            expected = f"a photograph of its own; {same.file.name} of pose {same.pose} is the same"
            log.add(Fault(one.file.name, expected, value=one.pose))
    return kept


def _glimpse(raw: RawFile) -> tuple[int, bytes]:
    """The size of a file and some bytes of its middle: two that differ in these are not the same."""
    size = raw.path.stat().st_size
    with raw.path.open("rb") as file:
        file.seek(size // 2)
        return size, file.read(_GLIMPSE)


def _cameras_apart(found: list[Photograph]) -> list[Photograph]:
    """A camera with several formats or focal lengths is several cameras, each with a name of its own."""
    formats: dict[str, set[tuple[int, int]]] = defaultdict(set)
    focal: dict[str, set[float | None]] = defaultdict(set)
    for one in found:
        formats[one.camera].add((one.head.width_px, one.head.height_px))
        focal[one.camera].add(one.head.focal_mm)

    def name(one: Photograph) -> str:
        words = [one.camera]
        if len(focal[one.camera]) > 1:
            words.append("unknown focal length" if one.head.focal_mm is None else f"{one.head.focal_mm:g} mm")
        if len(formats[one.camera]) > 1:
            words.append(f"{one.head.width_px} x {one.head.height_px}")
        return ", ".join(words)

    return [replace(one, camera=name(one)) for one in found]
