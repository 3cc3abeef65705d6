"""Files beside a raw file that are read along with it: AICON's orientations, the rays of COLMAP's points."""

from __future__ import annotations

import re
from pathlib import Path

from truing.formats.file_search import is_raw_file

_BESIDE = {".phc": (".ior", ".eor")}
_OF_MODEL = ("cameras", "images")


def companions(path: Path) -> tuple[Path, ...]:
    """The files read along with one: of the same name with another ending, else the only one that ends so."""
    stem, ending = _parts(path)
    if stem.lower() == "points3d":
        return tuple(one for name in _OF_MODEL if is_raw_file(one := path.with_name(f"{name}{ending}")))
    found = (_beside(path.parent, stem, other) for other in _BESIDE.get(ending, ()))
    return tuple(one for one in found if one is not None)


def plain_ending(path: Path) -> str:
    """The ending that tells the format, in small letters and without that of a compression."""
    return _parts(path)[1]


def _beside(folder: Path, stem: str, ending: str) -> Path | None:
    try:
        others = sorted(path for path in folder.iterdir() if plain_ending(path) == ending and is_raw_file(path))
    except OSError:
        return None
    same = [path for path in others if _parts(path)[0] == stem]
    return same[0] if same else others[0] if len(others) == 1 else None


def _parts(path: Path) -> tuple[str, str]:
    plain = Path(re.sub(r"\.(gz|bz2|xz|zip)$", "", path.name, flags=re.IGNORECASE))
    return plain.stem, plain.suffix.lower()
