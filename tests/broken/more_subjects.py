"""Further subjects for long fuzzing: markers, clouds, earlier models, and inputs of other commands."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from tests.broken.good import CAMPAIGNS
from tests.broken.network_subjects import NETWORKS, network_files
from tests.broken.subjects import SUBJECTS, Subject, good_files
from truing.open3d_library import load_open3d
from truing.pipeline.command_line import app

_TOML = '[campaign]\nname = "c"\nkind = "{kind}"\n{more}'
_POINTS = '[files.points]\npath = "{file}"\n{more}\n[noise]\npoint_mm = 0.1\n'
_NAMED = 'constants = { body = "b" }'
_COMPLIANCE = "\n".join(",".join("1e-9" if i == j else "0" for j in range(6)) for i in range(6)) + "\n"
_TRC = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100\t100\t2\t2\tmm\t100\t1\t2\nFrame#\tTime\tA1\t\t\tB2\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n"
    "1\t0.00\t1\t2\t3\t4\t5\t6\n2\t0.01\t1.1\t2.1\t3.1\t4.1\t5.1\t6.1\n"
)
_VSTARS = "".join(f"CODE{n} {n}.25 {n * n}.5 {7 - n}.125 0.01 0.01 0.02\n" for n in range(1, 8))
_RTL = "\r\n".join(
    [
        *("HEADER::", "File type  : rtl", "", "TARGET DATA::", "Target-count: 3", "Targets :", "0.0 25.0 50.0"),
        *("Flags: 0 0 2 0", "", "RUNS::", "Run-count: 2", "", "DEVIATIONS::", "Run Target Data:", "1 1 0.1", "1 2 0.2"),
        *("1 3 0.3", "2 3 0.4", "2 2 0.1", "2 1 0.0", "", "ENVIRONMENT::", "Air temp   : 20.1", "EOF::", ""),
    ]
)


def _cloud(ending: str, ascii_text: bool) -> bytes:
    open3d = load_open3d()
    points = np.random.default_rng(1).normal(size=(20, 3))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"c.{ending}"
        cloud = open3d.t.geometry.PointCloud(open3d.core.Tensor(points))
        open3d.t.io.write_point_cloud(str(path), cloud, write_ascii=ascii_text, compressed=not ascii_text)
        return path.read_bytes()


def _c3d() -> bytes:
    import ezc3d

    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["A1", "B2"]
    points = np.ones((4, 2, 3))
    points[:3] = np.random.default_rng(2).normal(size=(3, 2, 3))
    file["data"]["points"] = points
    with tempfile.TemporaryDirectory() as folder:
        file.write(str(Path(folder) / "c.c3d"))
        return (Path(folder) / "c.c3d").read_bytes()


def _of_points(file: str, content: bytes, more: str = _NAMED) -> dict[str, bytes]:
    toml = _TOML.format(kind="photogrammetry", more=_POINTS.format(file=file, more=more))
    return {"campaign.toml": toml.encode(), file: content}


@cache
def run_files(campaign: str) -> dict[str, bytes]:
    """Files of a campaign's run, except its page and its manifest."""
    with tempfile.TemporaryDirectory() as place:
        CAMPAIGNS[campaign](Path(place) / "c")
        words = ["run", str(Path(place) / "c"), "--out", str(Path(place) / "r"), "--quiet", "--qa=warn"]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
        left = [path for path in (Path(place) / "r").iterdir() if path.suffix in (".parquet", ".toml")]
        return {path.name: path.read_bytes() for path in left}


def _started(campaign: str) -> dict[str, bytes]:
    """A campaign that starts from its own model, as if that were of an earlier one."""
    files = good_files(campaign)
    toml = files["campaign.toml"].replace(b"[mechanism]", b'[mechanism]\nmodel = "model.toml"', 1)
    return {**files, "campaign.toml": toml, "model.toml": run_files(campaign)["model.toml"]}


def _compliant() -> dict[str, bytes]:
    files = good_files("bench")
    toml = files["campaign.toml"].replace(b"[mechanism]", b'[mechanism]\ncompliance_file = "c.csv"', 1)
    return {**files, "campaign.toml": toml, "c.csv": _COMPLIANCE.encode()}


@cache
def more_files(campaign: str) -> dict[str, bytes]:
    """The files of a campaign, or of a run, by name."""
    kind, _, form = campaign.partition("-")
    if kind == "network":
        return network_files(campaign)
    if kind in ("ply", "pcd"):
        return _of_points(f"p1.{kind}", _cloud(kind, form == "text"))
    made = {
        "c3d": lambda: _of_points("p.c3d", _c3d()),
        "trc": lambda: _of_points("p.trc", _TRC.encode()),
        "vstars": lambda: _of_points("p1.txt", _VSTARS.encode(), 'format = "vstars"\n' + _NAMED),
        "rtl": lambda: {
            "campaign.toml": _TOML.format(
                kind="interferometer",
                more='[files.positioning]\npath = "*.rtl"\n[interferometer]\nwavelength_nm = 633.0',
            ).encode(),
            "x.rtl": _RTL.encode(),
        },
        "started": lambda: _started(form),
        "compliant": _compliant,
        "run": lambda: run_files(form),
    }
    return made[kind]() if kind in made else good_files(campaign)


_READERS = (
    *(Subject(name, "p1.ply", "bytes") for name in ("ply-text", "ply-bytes")),
    *(Subject(name, "p1.pcd", "bytes") for name in ("pcd-text", "pcd-bytes")),
    Subject("c3d", "p.c3d", "bytes"),
    Subject("trc", "p.trc", "csv"),
    Subject("vstars", "p1.txt", "csv"),
    Subject("rtl", "x.rtl", "csv"),
    Subject("compliant", "c.csv", "csv"),
    *(Subject(f"started-{of}", "model.toml", "toml") for of in ("telescope", "bench")),
)
# `truing init` looks at raw files as they are, without a mapping.
_LOOKED_AT = tuple(
    replace(subject, command="init")
    for subject in (*SUBJECTS, *_READERS, *NETWORKS)
    if not subject.file.endswith(".toml")
)
_TABLES = ("qa", "diagnosis", "calibration", "poses", "observations", "requirements", "detectable")
_RUNS = (
    *(Subject("run-telescope", f"{name}.parquet", "parquet", command="export") for name in _TABLES),
    *(
        Subject("run-bench", f"{name}.parquet", "parquet", command="export")
        for name in ("sensor_matrix", "observations")
    ),
    *(Subject(f"run-{of}", "model.toml", "toml", command="export") for of in ("telescope", "bench")),
    *(Subject(f"started-{of}", "model.toml", "toml", command="predict") for of in ("telescope", "bench")),
    Subject("started-telescope", "configurations.csv", "csv", command="predict"),
)
MORE = (*_READERS, *NETWORKS, *_LOOKED_AT, *_RUNS)
