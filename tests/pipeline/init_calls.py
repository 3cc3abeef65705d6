"""Calls of `truing init` in tests, and tables for its raw files."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner, Result

from truing.pipeline.command_line import app
from truing.schemas.campaign import read_campaign


def init(folder: Path, *options: str) -> Result:
    return CliRunner().invoke(app, ["init", *options, str(folder)])


def written(folder: Path) -> dict[str, Any]:
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    document = tomllib.loads(text)
    read_campaign(document)
    return document


def starter(folder: Path, files: dict[str, str]) -> tuple[str, dict[str, Any]]:
    """The starter file of a folder with these files, as text and as it is read."""
    for name, text in files.items():
        (folder / name).write_text(text)
    assert init(folder).exit_code == 0
    return (folder / "campaign.toml").read_text(encoding="utf-8"), written(folder)


def rows(*columns: Any) -> str:
    return "".join(",".join(map(str, row)) + "\n" for row in zip(*columns, strict=True))


NUMBERS = np.random.default_rng(4)

TURNED = Rotation.from_rotvec(NUMBERS.uniform(-1.5, 1.5, (8, 3)))

PLACED = NUMBERS.uniform(-900.0, 900.0, (8, 3)).round(4)
