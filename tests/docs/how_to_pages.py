"""Examples of the how-to pages: the files of each section, the resulting tables, and the faults."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import PROJECT

FOLDER = PROJECT / "docs" / "how-to"
_FILE = re.compile(r"^`([^`\n]+\.\w+)`\n\n```\w+\n(.*?)```", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"-?\d+(\.\d+)?")
_TABLE = re.compile(r"^`(\w+)\.parquet`[^\n]*\n\n```csv\n(.*?)```", re.MULTILINE | re.DOTALL)
_ROW = re.compile(r"^\| `([^`]+)` \| (?:`([^`]+)`|nothing) \| `([^`]+)` \| `([^`]+)` \|$", re.MULTILINE)


@dataclass(frozen=True)
class Slip:
    """A wrong text in a file of an example, the right text that it replaces, and the message of truing."""

    file: str
    written: str
    instead_of: str
    said: str


@dataclass(frozen=True)
class Example:
    """A campaign as a page shows it: its files by name, and what its tables hold, as CSV."""

    page: str
    files: dict[str, str]
    tables: dict[str, str]

    def write(self, folder: Path) -> Path:
        """The folder with all files of the example."""
        for name, text in self.files.items():
            write_listing(folder / name, text)
        return folder


def examples(page: Path) -> list[Example]:
    """A page's examples: files up to the next campaign.toml belong to one, and tables after it."""
    text = page.read_text(encoding="utf-8")
    found = sorted([*_FILE.finditer(text), *_TABLE.finditer(text)], key=lambda match: match.start())
    made: list[Example] = []
    files: dict[str, str] = {}
    for match in found:
        if match.re is _TABLE:
            made[-1].tables[match[1]] = match[2]
            continue
        files[match[1]] = match[2]
        if match[1] == "campaign.toml":
            made.append(Example(page.stem, files, {}))
            files = {}
    return made


def slips(page: Path) -> list[Slip]:
    """Errors that a page describes for its first example."""
    return [Slip(m[1], m[2] or "", m[3], m[4]) for m in _ROW.finditer(page.read_text(encoding="utf-8"))]


def write_listing(path: Path, text: str) -> None:
    """A file of what a page lists: as it stands, or as the binary file that the name asks for."""
    writers = {".c3d": write_c3d, ".xlsx": write_workbook, ".mat": write_matlab}
    writers.get(path.suffix, lambda place, listing: place.write_bytes(listing.encode()))(path, text)


def write_workbook(path: Path, listing: str) -> None:
    """A workbook of the sheets that a page lists, cells separated by commas, numbers as such."""
    openpyxl = pytest.importorskip("openpyxl", reason="not installed")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for line in listing.splitlines():
        if line.startswith("["):
            book.create_sheet(line.strip("[]"))
            continue
        book.worksheets[-1].append([float(cell) if _NUMBER.fullmatch(cell) else cell for cell in line.split(",")])
    book.save(path)


def write_matlab(path: Path, listing: str) -> None:
    """A MATLAB file of the matrices that a page lists, fields of a struct as a.b, rows separated by semicolons."""
    from scipy.io import savemat

    found: dict[str, object] = {}
    for line in listing.splitlines():
        name, _, text = line.partition(" = ")
        rows = np.array([[float(word) for word in row.split()] for row in text.split(";")])
        struct, _, field = name.rpartition(".")
        (found.setdefault(struct, {}) if struct else found)[field] = rows  # type: ignore[index]
    savemat(path, found)


def write_c3d(path: Path, listing: str) -> None:
    """A C3D file of the markers that a page lists: frame, label, coordinates and unit; nothing where unseen."""
    ezc3d = pytest.importorskip("ezc3d", reason="no ezc3d on this platform")
    rows = [line.split() for line in listing.splitlines()[1:]]
    labels = list(dict.fromkeys(row[1] for row in rows))
    frames = sorted({int(row[0]) for row in rows})
    points = np.full((4, len(labels), len(frames)), np.nan)
    for row in rows:
        if len(row) > 2:
            points[:, labels.index(row[1]), frames.index(int(row[0]))] = [*map(float, row[2:5]), 1.0]
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = labels
    file["parameters"]["POINT"]["UNITS"]["value"] = [rows[0][5]]
    file["data"]["points"] = points
    file.write(str(path))
