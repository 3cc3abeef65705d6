"""Paths that hold no regular file: circular links, pipes, devices, folders."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from tests.broken.spoiling import Broken, Spoil


def _linked(name: str, to: str) -> Spoil:
    def spoil(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).symlink_to(to)

    return spoil


def _pipe(name: str) -> Spoil:
    def spoil(folder: Path) -> None:
        (folder / name).unlink(missing_ok=True)
        os.mkfifo(folder / name)

    return spoil


def _folder(name: str) -> Spoil:
    def spoil(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).mkdir()

    return spoil


def _started_from(path: str, pipe: str | None = None) -> Spoil:
    """The campaign starts from an earlier model at this path."""

    def spoil(folder: Path) -> None:
        if pipe is not None:
            os.mkfifo(folder / pipe)
        text = (folder / "campaign.toml").read_text().replace("[mechanism]", f'[mechanism]\nmodel = "{path}"', 1)
        (folder / "campaign.toml").write_text(text)

    return spoil


_REGULAR = ("campaign.toml: expected a regular file",)
_ALL = (
    Broken("toml-links-in-a-circle", "telescope", _linked("campaign.toml", "campaign.toml"), _REGULAR),
    Broken("toml-a-pipe", "telescope", _pipe("campaign.toml"), _REGULAR),
    Broken("toml-a-device", "telescope", _linked("campaign.toml", "/dev/zero"), _REGULAR),
    Broken("toml-hidden-by-a-folder", "telescope", _folder("campaign.toml"), _REGULAR),
    Broken(
        "points-link-in-a-circle",
        "telescope",
        _linked("points.csv", "points.csv"),
        (r"points\.csv: expected a regular",),
    ),
    Broken("points-a-pipe", "telescope", _pipe("points.csv"), (r"points\.csv: expected a regular",)),
    Broken(
        "readings-a-device",
        "bench",
        _linked("interferometer.csv", "/dev/zero"),
        (r"interferometer\.csv: expected a regular",),
    ),
    Broken("model-a-pipe", "telescope", _started_from("m.toml", "m.toml"), ("mechanism.model: found 'm.toml'",)),
    Broken("model-a-device", "telescope", _started_from("/dev/zero"), (r"mechanism\.model: found '/dev/zero'",)),
    Broken("model-a-folder", "telescope", _started_from("."), (r"mechanism\.model: found '\.'",)),
)
CASES = () if sys.platform == "win32" else _ALL
