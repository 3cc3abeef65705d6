"""Rewrite a campaign in the file formats of other laboratories: each function writes a converted copy of a folder.

Only the raw files and ``[files.*]`` of campaign.toml change; what was measured stays, to the digits that are
written.
"""

from __future__ import annotations

import csv
import gzip
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from tests.blind.generator.quaternions import Array, fit_motion, rotate

Rows = list[dict[str, str]]
AXES = ("x", "y", "z")
INCH_MM = 25.4


def german(source: Path, out: Path) -> Path:
    """One CSV per table from a German spreadsheet: decimal comma, semicolons, umlauts in Latin-1, CRLF,
    points in thousands.
    """
    names = {
        "points": {"pose": "Stellung", "body": "Körper", "target": "Zielmarke", **_german_axes()},
        "targets": {"body": "Körper", "target": "Zielmarke", **_german_axes(), "leg": "Bein"},
        "configurations": {
            "pose": "Stellung", "role": "role", "time_s": "Zeit (s)", "temperature_c": "Temperatur (°C)",
            **{f"rho{i}_mm": f"Stößel {i}" for i in range(1, 7)},
        },
    }  # fmt: skip
    files = {"points": "Messpunkte.csv", "targets": "Vermessung.csv", "configurations": "Stellungen.csv"}
    sections = []
    for table, columns in names.items():
        _write_german(out / files[table], _read(source / f"{table}.csv"), columns)
        sections.append(
            f'[files.{table}]\npath = "{files[table]}"\nseparator = ";"\ndecimal = ","\nthousands = "."\n'
            f'encoding = "latin-1"\ncolumns = {_inline(columns)}'
        )
    return _with_mapping(source, out, sections)


def _german_axes() -> dict[str, str]:
    return {f"{axis}_mm": f"{axis.upper()} (mm)" for axis in AXES}


def _write_german(path: Path, rows: Rows, columns: dict[str, str]) -> None:
    lines = [";".join(columns.values())]
    lines += [";".join(_german_number(name, row[name]) for name in columns) for row in rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode("latin-1"))


def _german_number(name: str, text: str) -> str:
    if not name.endswith(("_mm", "_s", "_c")) or not text:
        return text
    decimals = len(text.partition(".")[2])
    return f"{float(text):,.{decimals}f}".translate(str.maketrans(",.", ".,"))


def whitespace_per_pose(source: Path, out: Path) -> Path:
    """One file per pose in metres, columns apart by white space, no header, comments above, one label for
    body and target.
    """
    for pose, rows in _by_pose(_read(source / "points.csv")).items():
        lines = [f"# station protocol, pose {pose}", "# label  X  Y  Z  [m]"]
        labels = [f"{row['body']}_{row['target']}" for row in rows]
        places = ["   ".join(_metres(row[f"{a}_mm"]) for a in AXES) for row in rows]
        lines += [f"{label}  {place}" for label, place in zip(labels, places, strict=True)]
        _write_text(out / "raw" / f"pose_{pose}.txt", lines)
    points = (
        '[files.points]\npath = "raw/pose_*.txt"\nformat = "delimited"\nseparator = "whitespace"\nheader = false\n'
        'names = ["target", "x_mm", "y_mm", "z_mm"]\ncomment = "#"\nunit = "m"\nfrom_name = \'pose_(?P<pose>\\d+)\'\n'
        "split = { target = '(?P<body>[a-z]+\\d?)_(?P<target>.*)' }"
    )
    return _with_mapping(source, out, [points], kept=("targets", "configurations"))


def _metres(text: str) -> str:
    return f"{float(text) / 1000:.9f}"


def wide(source: Path, out: Path) -> Path:
    """One row per pose and three columns per target, gzipped, in inches, ``0 0 0`` where a target was not
    seen.
    """
    by_pose = _by_pose(_read(source / "points.csv"))
    labels = [(row["body"], row["target"]) for row in _read(source / "targets.csv")]
    lines = [",".join(["pose", *(f"{body}-{target}-{axis}" for body, target in labels for axis in AXES)])]
    for pose, rows in by_pose.items():
        seen = {(row["body"], row["target"]): [_inches(row[f"{a}_mm"]) for a in AXES] for row in rows}
        lines.append(",".join([pose, *(value for label in labels for value in seen.get(label, ["0", "0", "0"]))]))
    path = out / "tracker.csv.gz"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(("\n".join(lines) + "\n").encode(), mtime=0))
    points = (
        '[files.points]\npath = "tracker.csv.gz"\nwide = "{body}-{target}-{axis}"\nunit = "in"\nmissing = ["0 0 0"]'
    )
    return _with_mapping(source, out, [points], kept=("targets", "configurations"))


def _inches(text: str) -> str:
    return f"{float(text) / INCH_MM:.8f}"


def unlabelled(source: Path, out: Path, rng: np.random.Generator, *, bodies_known: bool = True) -> Path:
    """The contract's points.csv without target names, the rows of each pose in any order; without bodies too
    if asked.
    """
    columns = ("pose", "body", "x_mm", "y_mm", "z_mm") if bodies_known else ("pose", "x_mm", "y_mm", "z_mm")
    lines = [",".join(columns)]
    for rows in _by_pose(_read(source / "points.csv")).values():
        lines += [",".join(rows[k][name] for name in columns) for k in rng.permutation(len(rows))]
    _write_text(out / "points.csv", lines)
    return _with_mapping(source, out, [], kept=("targets", "configurations"))


def dense_scans(
    source: Path, out: Path, rng: np.random.Generator, *, count: int = 10_000, sigma_mm: float = 0.02
) -> Path:
    """A PLY of ``count`` unlabelled points per pose for base and platform each, and one of each as the
    reference.

    The bodies stand where their targets without leg stand; what is scanned of them is a plate with bumps of
    its own, so that a scan fits its reference in one way only. Every scan samples other places of the plate.
    """
    survey, points = _read(source / "targets.csv"), _by_pose(_read(source / "points.csv"))
    reach = {"base": 220.0, "platform": 140.0}
    for k, (body, radius) in enumerate(reach.items()):
        bumps = np.random.default_rng(k).uniform(-0.7, 0.7, (9, 2)) * radius
        write_ply(out / "scans" / f"reference_{body}.ply", _plate(bumps, radius, count, rng))
        reference = {row["target"]: _place(row) for row in survey if row["body"] == body and not row["leg"]}
        for pose, rows in points.items():
            seen = {row["target"]: _place(row) for row in rows if row["body"] == body and row["target"] in reference}
            turn, shift = fit_motion(np.array([reference[name] for name in seen]), np.array(list(seen.values())))
            scan = rotate(turn, _plate(bumps, radius, count, rng)) + shift
            write_ply(out / "scans" / f"pose_{pose}_{body}.ply", scan + sigma_mm * rng.normal(size=scan.shape))
    _write_text(out / "configurations.csv", (source / "configurations.csv").read_text(encoding="utf-8").splitlines())
    sections = [
        '[files.scans]\npath = "scans/pose_*.ply"\nfrom_name = \'pose_(?P<pose>\\d+)_(?P<body>[a-z]+)\'\nunit = "mm"',
        '[files.surfaces]\npath = "scans/reference_*.ply"\nfrom_name = \'reference_(?P<body>[a-z]+)\'\nunit = "mm"',
    ]
    return _with_mapping(source, out, sections)


def _plate(bumps: Array, radius: float, count: int, rng: np.random.Generator) -> Array:
    """Points (count, 3) on a disc with one hill or hollow per bump (K, 2), mm."""
    r, angle = radius * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    xy = np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)
    distance = np.sum((xy[:, None] - bumps) ** 2, axis=-1) / (0.2 * radius) ** 2
    heights = 0.15 * radius * np.where(np.arange(len(bumps)) % 3 == 0, -1.0, 1.0)
    return np.column_stack([xy, np.exp(-distance) @ heights])


def write_ply(path: Path, points: Array) -> None:
    """Points (N, 3) as a binary PLY of doubles."""
    path.parent.mkdir(parents=True, exist_ok=True)
    header = "ply\nformat binary_little_endian 1.0\n" + f"element vertex {len(points)}\n"
    header += "".join(f"property double {axis}\n" for axis in AXES) + "end_header\n"
    path.write_bytes(header.encode() + points.astype("<f8").tobytes())


DISGUISES: dict[str, Callable[[Path, Path], Path]] = {
    "german": german,
    "whitespace_per_pose": whitespace_per_pose,
    "wide": wide,
}
"""Those that keep every label and need no draw."""


def _read(path: Path) -> Rows:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _place(row: dict[str, str]) -> Array:
    return np.array([float(row[f"{axis}_mm"]) for axis in AXES])


def _by_pose(rows: Rows) -> dict[str, Rows]:
    poses: dict[str, Rows] = {}
    for row in rows:
        poses.setdefault(row["pose"], []).append(row)
    return poses


def _inline(columns: dict[str, str]) -> str:
    return "{ " + ", ".join(f'{name} = "{raw}"' for name, raw in columns.items()) + " }"


def _write_text(path: Path, lines: Iterable[str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _with_mapping(source: Path, out: Path, sections: Sequence[str], kept: Sequence[str] = ()) -> Path:
    """Completes the copy: campaign.toml with the sections added, and the tables that stay as they are."""
    for table in kept:
        _write_text(out / f"{table}.csv", (source / f"{table}.csv").read_text(encoding="utf-8").splitlines())
    settings = (source / "campaign.toml").read_text(encoding="utf-8")
    _write_text(out / "campaign.toml", [settings, *(section + "\n" for section in sections)])
    return out
