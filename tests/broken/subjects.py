"""Subjects of the fuzzing: small good campaigns in memory, with the files to damage and the kinds of damage."""

from __future__ import annotations

import gzip
import io
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pyarrow.csv
import pyarrow.parquet as pq

from tests.broken.good import CAMPAIGNS

_HEAD = "run,step,time_s,load_axis,load,channel,"
_MAPPED = """
[files.points]
path = "export_*.csv"
from_name = "export_(?P<set>\\\\d+)"
columns = { x_mm = "X", y_mm = 4, z_mm = "Z" }
units = { x_mm = "mm", y_mm = "mm" }
unit = "mm"
missing = ["-999", "0 0 0", "n/a"]
comment = "#"
skip_lines = 0
keep_lines = "[a-zX]"
separator = ","
decimal = "."
encoding = "utf-8"
quote = '"'
split = { label = "(?P<body>[a-z0-9]+):(?P<target>.+)" }
rename = { target = { "Q(.*)" = "\\\\1" } }
offset = { pose = 0 }
select = { body = "base|platform" }
ignore = "filler.*"
"""


@dataclass(frozen=True)
class Subject:
    """One file of a good campaign, the form in which it is damaged (csv, toml, parquet or bytes), and who reads it."""

    campaign: str
    file: str
    form: str
    command: str = "check"

    @property
    def name(self) -> str:
        """For messages."""
        return f"{self.campaign}/{self.file}" + ("" if self.command == "check" else f" {self.command}")


def _mapped(files: dict[str, bytes]) -> dict[str, bytes]:
    """The telescope's points as a lab's own export, read by a mapping that uses most of its keys."""
    rows = [line.split(",") for line in files["points.csv"].decode().splitlines()[1:]]
    text = "pose,label,X,Y,Z,filler1\n" + "".join(f"{p},{b}:Q{t},{x},{y},{z},7\n" for p, b, t, x, y, z in rows)
    toml = files["campaign.toml"].decode() + _MAPPED
    left = {name: content for name, content in files.items() if name != "points.csv"}
    return {**left, "campaign.toml": toml.encode(), "export_1.csv": text.encode()}


def _as_parquet(files: dict[str, bytes]) -> dict[str, bytes]:
    found = {}
    for name, content in files.items():
        if name.endswith(".csv"):
            out = io.BytesIO()
            pq.write_table(pyarrow.csv.read_csv(io.BytesIO(content)), out)
            name, content = name.replace(".csv", ".parquet"), out.getvalue()
        found[name] = content
    return found


def _packed(files: dict[str, bytes]) -> dict[str, bytes]:
    toml = files["campaign.toml"] + b'\n[files.points]\npath = "points.csv.gz"\n'
    left = {name: content for name, content in files.items() if name != "points.csv"}
    return {**left, "campaign.toml": toml, "points.csv.gz": gzip.compress(files["points.csv"], mtime=0)}


def _positioning() -> dict[str, bytes]:
    toml = b'[campaign]\nname = "axis"\nkind = "interferometer"\n[interferometer]\nwavelength_nm = 632.99\n'
    ways = ("forward", "backward")
    rows = [f"a,{at},{way},{cycle},{at + 0.001 * cycle}" for at in (10, 20) for way in ways for cycle in (1, 2)]
    table = "\n".join(["run,target_mm,direction,cycle,position_mm", *rows]) + "\n"
    steps = [f"1,{n},{n},0,0,{n},0,0,0,0,0,.{n},0,0,0" for n in range(4)]
    six = "run,step,time_s,fx_n,fy_n,fz_n,mx_nm,my_nm,mz_nm,dx_mm,dy_mm,dz_mm,rx_rad,ry_rad,rz_rad"
    return {
        "campaign.toml": toml,
        "positioning.csv": table.encode(),
        "displacement.csv": ("\n".join([six, *steps]) + "\n").encode(),
    }


def _quadrature() -> dict[str, bytes]:
    """Raw signals of one channel that go round their ellipse ten times."""
    import numpy as np

    phase = np.linspace(0.0, 62.0, 160)
    x, y = 30.0 + 500.0 * np.cos(phase), -12.0 + 430.0 * np.sin(phase + 0.12)
    rows = [f"1,{n // 4},{n},fz,{n // 4},dx,{x[n]:.6f},{y[n]:.6f}" for n in range(len(phase))]
    toml = b'[campaign]\nname = "raw"\nkind = "interferometer"\n[interferometer]\nwavelength_nm = 632.99\n'
    return {"campaign.toml": toml, "quadrature.csv": "\n".join([_HEAD + "signal_x,signal_y", *rows]).encode()}


@cache
def good_files(campaign: str) -> dict[str, bytes]:
    """The files of a good campaign by name."""
    made = {"mapped": _mapped, "telescope-parquet": _as_parquet, "packed": _packed, "bench-parquet": _as_parquet}
    if campaign in made:
        return made[campaign](good_files(campaign.partition("-")[0] if "-" in campaign else "telescope"))
    if campaign in ("axis", "raw"):
        return _positioning() if campaign == "axis" else _quadrature()
    with tempfile.TemporaryDirectory() as folder:
        CAMPAIGNS[campaign](Path(folder) / "c")
        files = {path.name: path.read_bytes() for path in (Path(folder) / "c").iterdir()}
    return {name: content for name, content in files.items() if name.endswith((".toml", ".csv"))}


SUBJECTS = (
    *(Subject("telescope", name, "csv") for name in ("points.csv", "configurations.csv", "targets.csv")),
    *(Subject("bench", name, "csv") for name in ("interferometer.csv", "signals.csv")),
    Subject("axis", "positioning.csv", "csv"),
    Subject("axis", "displacement.csv", "csv"),
    Subject("raw", "quadrature.csv", "csv"),
    Subject("mapped", "export_1.csv", "csv"),
    *(Subject(name, "campaign.toml", "toml") for name in ("telescope", "bench", "mapped", "raw")),
    *(Subject("telescope-parquet", f"{name}.parquet", "parquet") for name in ("points", "configurations", "targets")),
    *(Subject("bench-parquet", f"{name}.parquet", "parquet") for name in ("interferometer", "signals")),
    Subject("telescope-parquet", "points.parquet", "bytes"),
    Subject("bench-parquet", "signals.parquet", "bytes"),
    Subject("packed", "points.csv.gz", "bytes"),
)
