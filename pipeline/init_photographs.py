"""What `truing init` makes of photographs: where they lie, and how their folders or names tell the pose."""

from __future__ import annotations

import glob
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truing.formats.source import PICTURES

if TYPE_CHECKING:
    from truing.formats.guess import Guess

_NUMBERED = re.compile(r"(?P<pose>.+)[-_ ]\d+")
_IN_FOLDERS = r"(?P<pose>[^/]+)/[^/]+$"
_IN_NAMES = r"^(?P<pose>.+)[-_ ]\d+\."
_BY_CONTRACT = "images"

NEEDED = (
    "beside photographs: scale_bars.csv (bar,first,second,length_mm,sigma_mm), and image_targets.csv "
    "(family,code,body,target) where codes are not the targets' own names",
)


def is_picture(path: Path) -> bool:
    """Whether a file is a photograph by its ending."""
    return path.suffix.lower().removeprefix(".") in PICTURES


def photograph_entries(folder: Path, pictures: Sequence[Path]) -> list[tuple[str, Path, int, Guess]]:
    """An entry per folder tree and ending: glob, one of the photographs, how many, and the keys for [files.images]."""
    from truing.formats.guess import Guess

    groups: dict[tuple[str, str], list[Path]] = {}
    for path in pictures:
        relative = path.relative_to(folder)
        top = relative.parts[0] if len(relative.parts) > 1 else ""
        groups.setdefault((top, path.suffix), []).append(relative)
    tops = len({top for top, _ in groups})
    found = []
    for (top, suffix), paths in sorted(groups.items()):
        pattern, mapping = _read_by(top, suffix, paths, alone=tops == 1)
        guess = Guess(mapping={} if top == _BY_CONTRACT else mapping, table="images", notes=(*NEEDED, *_told(mapping)))
        found.append((pattern, folder / paths[0], len(paths), guess))
    return found


def _read_by(top: str, suffix: str, paths: Sequence[Path], *, alone: bool) -> tuple[str, dict[str, Any]]:
    """The glob that finds these photographs, and what tells their poses; ``alone``: no other folder holds any."""
    depth = max(len(path.parts) for path in paths)
    head = f"{glob.escape(top)}/" if top else ""
    if depth > (2 if top else 1):
        return f"{head}**/*{suffix}", {"from_name": _IN_FOLDERS}
    before = [match["pose"] if (match := _NUMBERED.fullmatch(path.stem)) else "" for path in paths]
    if top and not alone and len(set(before)) == 1:  # cameras number on: IMG_0412 tells nothing, its folder does
        return f"{head}*{suffix}", {"from_name": _IN_FOLDERS}
    if all(before):
        return f"{head}*{suffix}", {"from_name": _in_names(before)}
    return f"{head}*{suffix}", {"constants": {"pose": 1}}


def _in_names(before: Sequence[str]) -> str:
    """What finds the pose in names that begin so: the number alone where they differ in a number at their end."""
    parts = [re.fullmatch(r"(.*?)(\d+)", text) for text in before]
    heads = {part[1] if part else None for part in parts}
    (head,) = heads if len(heads) == 1 else (None,)
    return _IN_NAMES if not head else rf"^{re.escape(head)}(?P<pose>\d+)[-_ ]\d+\."


def _told(mapping: dict[str, Any]) -> tuple[str, ...]:
    if "constants" in mapping:
        return ("all photographs are of one pose, as far as their names tell",)
    return ()
