"""Faults of a photogrammetric campaign's tables."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from tests.broken.spoiling import (
    Broken,
    appended,
    both,
    cell,
    cells,
    cut,
    every,
    gone,
    replaced,
    scaled,
    whole,
    without,
    without_column,
)
from truing.pipeline.problems import ExitCode

_HEAD = b"pose,body,target,x_mm,y_mm,z_mm\n"


def _as_parquet(change: object = None) -> object:
    def spoil(folder: Path) -> None:
        table = pa.csv.read_csv(folder / "points.csv")
        (folder / "points.csv").unlink()
        pq.write_table(table if change is None else change(table), folder / "points.parquet")

    return spoil


def _texts(table: pa.Table) -> pa.Table:
    words = pa.array([f"{value.as_py()} mm" for value in table.column("x_mm")])
    return table.set_column(3, "x_mm", words)


def _other_columns(table: pa.Table) -> pa.Table:
    return table.rename_columns(["a", "b", "c", "d", "e", "f"])


def _both_forms(folder: Path) -> None:
    pq.write_table(pa.csv.read_csv(folder / "points.csv"), folder / "points.parquet")


def _packed(content: bytes) -> object:
    def spoil(folder: Path) -> None:
        (folder / "points.csv").unlink()
        (folder / "points.csv.gz").write_bytes(content)
        with open(folder / "campaign.toml", "a") as file:
            file.write('[files.points]\npath = "points.csv.gz"\n')

    return spoil


def _exchanged_heads(folder: Path) -> None:
    text = (folder / "points.csv").read_text()
    (folder / "points.csv").write_text(text.replace("x_mm,y_mm", "y_mm,x_mm", 1))


def _doubled_rows(folder: Path) -> None:
    lines = (folder / "points.csv").read_text().splitlines()
    (folder / "points.csv").write_text("\n".join([*lines, *lines[40:43]]) + "\n")


def _in_one_place(folder: Path) -> None:
    lines = (folder / "targets.csv").read_text().splitlines()
    same = [",".join([*line.split(",")[:2], "10.0", "20.0", "30.0", line.split(",")[5]]) for line in lines[1:]]
    (folder / "targets.csv").write_text("\n".join([lines[0], *same]) + "\n")


def _utf16(folder: Path) -> None:
    text = (folder / "points.csv").read_text()
    (folder / "points.csv").write_text(text, encoding="utf-16")


_RANDOM = np.random.default_rng(5).integers(0, 256, 4000, dtype=np.uint8).tobytes()

CASES = (
    Broken("points-absent", "telescope", gone("points.csv"), ("points",)),
    Broken("points-empty-file", "telescope", whole("points.csv", b""), (r"points\.csv",)),
    Broken("points-head-alone", "telescope", whole("points.csv", _HEAD), (r"points\.csv",)),
    Broken("points-truncated", "telescope", cut("points.csv", 0.731), (r"points\.csv",)),
    Broken("points-binary", "telescope", whole("points.csv", _RANDOM), (r"points\.csv",)),
    Broken("points-zeros", "telescope", whole("points.csv", _HEAD + b"\x00" * 5000), (r"points\.csv",)),
    Broken("points-one-endless-line", "telescope", whole("points.csv", _HEAD + b"7" * 3_000_000), (r"points\.csv",)),
    Broken("points-open-quote", "telescope", replaced("points.csv", "B02", '"B02'), (r"points\.csv",)),
    Broken(
        "points-too-many-fields",
        "telescope",
        replaced("points.csv", ",B02,", ",B02,1.0,"),
        (r"points\.csv", "row|line"),
    ),
    Broken("points-column-absent", "telescope", without_column("points.csv", "z_mm"), ("z_mm",)),
    Broken("points-column-twice", "telescope", replaced("points.csv", "x_mm,y_mm", "x_mm,x_mm"), ("x_mm",)),
    Broken("points-word-for-number", "telescope", cell("points.csv", 4, "x_mm", "left"), ("row|line", "x_mm", "left")),
    Broken("points-decimal-commas", "telescope", cell("points.csv", 4, "x_mm", '"12,5"'), ("x_mm", "12,5")),
    Broken("points-infinite", "telescope", cell("points.csv", 4, "x_mm", "inf"), ("x_mm", "inf")),
    Broken("points-overflowing", "telescope", cell("points.csv", 4, "x_mm", "1e999"), ("x_mm", "1e999|inf")),
    Broken("points-gigantic", "telescope", cell("points.csv", 4, "x_mm", "1e200"), ("x_mm", "1e")),
    Broken("points-some-nan", "telescope", cell("points.csv", 4, "x_mm", "NaN"), ("x_mm",)),
    Broken("points-twice", "telescope", _doubled_rows, ("pose", "twice|once|duplicate")),
    Broken("points-of-unknown-body", "telescope", replaced("points.csv", "0,base,", "0,bse,", 1), ("bse",)),
    Broken("points-of-unknown-pose", "telescope", replaced("points.csv", "0,base,B01", "77,base,B01", 1), ("77",)),
    Broken("points-in-utf-16", "telescope", _utf16, (), ExitCode.DONE),
    Broken("points-both-forms", "telescope", _both_forms, (r"points\.csv", r"points\.parquet")),
    Broken("parquet-of-texts", "telescope", _as_parquet(_texts), (r"points\.parquet", "x_mm")),
    Broken("parquet-of-other-columns", "telescope", _as_parquet(_other_columns), (r"points\.parquet", "x_mm")),
    Broken(
        "parquet-unreadable",
        "telescope",
        both(gone("points.csv"), whole("points.parquet", _RANDOM)),
        (r"points\.parquet",),
    ),
    Broken("parquet-truncated", "telescope", both(_as_parquet(), cut("points.parquet", 0.6)), (r"points\.parquet",)),
    Broken("archive-broken", "telescope", _packed(gzip.compress(b"pose,body\n" * 999)[:40]), (r"points\.csv\.gz",)),
    Broken("archive-is-none", "telescope", _packed(b"pose,body,target"), (r"points\.csv\.gz",)),
    Broken(
        "archive-explodes",
        "telescope",
        _packed(gzip.compress(_HEAD + b"\n" * 80_000_000, 9)),
        ("may be a decompression bomb",),
    ),
    Broken(
        "metres-for-millimetres",
        "telescope",
        both(*(cells("points.csv", f"{c}_mm", scaled(1e-3), every) for c in "xyz")),
        ("base to be as large as in targets.csv; is the unit right",),
    ),
    Broken("axes-exchanged", "telescope", _exchanged_heads, ("label|mirror|hand|noise|gross",), ExitCode.FAILED_CHECK),
    Broken(
        "poses-twice",
        "telescope",
        appended("configurations.csv", "3,calibration,9000.0,10,10,10,10,10,10,20.0\n"),
        ("pose", "3"),
    ),
    Broken(
        "role-unknown",
        "telescope",
        replaced("configurations.csv", "calibration", "calibartion"),
        ("role", "calibartion"),
    ),
    Broken("leg-without-reading", "telescope", without_column("configurations.csv", "rho6_mm"), ("rho6_mm",)),
    Broken("reading-empty", "telescope", cell("configurations.csv", 2, "rho3_mm", ""), ("rho3_mm",)),
    Broken("reading-gigantic", "telescope", cell("configurations.csv", 2, "rho3_mm", "1e150"), ("rho3_mm", "1e")),
    Broken(
        "readings-in-metres",
        "telescope",
        both(*(cells("configurations.csv", f"rho{k}_mm", scaled(1e-3), every) for k in range(1, 7))),
        ("repeatability",),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "nothing-to-calibrate-from",
        "telescope",
        cells("configurations.csv", "role", lambda _: "verification", every),
        (),
        ExitCode.DONE,
        whole=True,
    ),
    Broken("survey-absent", "telescope", gone("targets.csv"), (), ExitCode.DONE),
    Broken("survey-in-one-place", "telescope", _in_one_place, ("target",), ExitCode.FAILED_CHECK),
    Broken(
        "survey-of-leg-nine",
        "telescope",
        cells("targets.csv", "leg", lambda _: "9", lambda row: row["target"] == "A1"),
        ("leg", "9"),
    ),
    Broken("survey-target-twice", "telescope", replaced("targets.csv", "base,B02", "base,B01"), ("B01",)),
    Broken(
        "two-targets-left",
        "telescope",
        without("points.csv", lambda row: row["body"] == "platform" and row["target"] not in ("P01", "P02")),
        ("platform",),
        ExitCode.FAILED_CHECK,
    ),
)
