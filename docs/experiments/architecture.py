"""Figures and lists of docs/architecture.md: the packages, and three flows through the files.

python -m docs.experiments.architecture
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path

from docs.experiments.marked_tables import renew, table

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "architecture.md"
FIGURES = ROOT / "docs" / "figures"


@dataclass(frozen=True)
class Package:
    """A box of the drawing: folder of the project, purpose, column and row of its place."""

    name: str
    folder: str
    purpose: str
    column: float
    row: int


PACKAGES = (
    Package("pipeline", "pipeline", "command line, order, freshness", 1.5, 0),
    Package("stages", "stages", "tables to arrays and back", 1.5, 1),
    Package("runs", "truing/runs", "open, export, compare runs", 0, 2),
    Package("calibration", "truing/calibration", "identify a machine", 2, 2),
    Package("quality", "truing/quality", "figures for quality checks", 1, 2),
    Package("formats", "truing/formats", "read raw files", 3, 2),
    Package("report", "truing/report", "tables to sentences, figures", 0, 3),
    Package("belonging", "truing/belonging", "do the data belong together", 0.75, 4),
    Package("simulation", "truing/simulation", "machine, sensor, causes", 1.4, 5),
    Package("inference", "truing/inference", "causes against noise", 0.1, 6),
    Package("estimation", "truing/estimation", "fits, covariances", 1.12, 6),
    Package("schemas", "schemas", "columns, campaign.toml", 2.5, 7),
)


@dataclass(frozen=True)
class FlowStep:
    """A step of a flow: the file, the function or class that does it, what it does, and what it hands on."""

    file: str
    name: str
    does: str
    result: str


FLOWS: Mapping[str, tuple[FlowStep, ...]] = {
    "finding": (
        FlowStep(
            "truing/formats/read.py",
            "read_table",
            "reads the raw file by its mapping, in batches",
            "batches of columns",
        ),
        FlowStep(
            "stages/ingestion/points.py", "Points", "checks every point and brings it to mm", "observations.parquet"
        ),
        FlowStep(
            "stages/quality/point_checks.py",
            "checks",
            "tests whether tables belong together, and their quality",
            "qa.parquet",
        ),
        FlowStep(
            "truing/estimation/rigid_poses/body_estimate.py",
            "estimate_body",
            "fits the pose of each body, finds gross errors",
            "rigid fits with covariance",
        ),
        FlowStep(
            "stages/rigid_poses/body_poses.py",
            "body_poses",
            "writes poses relative to the base, and residuals",
            "poses.parquet, residuals.parquet",
        ),
        FlowStep(
            "stages/diagnosis/mechanism_points.py",
            "assemble",
            "assembles points, readings, tolerances and noise",
            "DiagnosisData",
        ),
        FlowStep(
            "truing/simulation/mechanisms/model.py",
            "MechanismModel",
            "predicts every point, with exact derivatives",
            "prediction, Jacobian",
        ),
        FlowStep(
            "truing/inference/linear_problem.py",
            "whiten",
            "divides by noise and eliminates the unknowns of the model",
            "Whitened",
        ),
        FlowStep(
            "truing/inference/search.py",
            "Search",
            "scores all candidates of all causes, with p-value",
            "ranked candidates",
        ),
        FlowStep(
            "truing/inference/selection.py",
            "CauseSelection",
            "accepts causes one by one and refits the model",
            "CauseDiagnosis",
        ),
        FlowStep("stages/diagnosis/rows.py", "diagnosis_table", "writes one row per cause", "diagnosis.parquet"),
        FlowStep(
            "truing/report/diagnosis/section.py",
            "diagnosis",
            "turns the rows into sentences and figures",
            "report.html",
        ),
    ),
    "calibration-matrix": (
        FlowStep(
            "truing/formats/read.py", "read_table", "reads the raw file of signals by its mapping", "batches of columns"
        ),
        FlowStep(
            "stages/ingestion/signal_table.py",
            "read_signals",
            "checks signals, loads and times of each load step",
            "signals.parquet",
        ),
        FlowStep(
            "stages/quality/signal_checks.py",
            "signal_checks",
            "tests clipping, noise, load directions, exchanged rows",
            "qa.parquet",
        ),
        FlowStep(
            "stages/common/recorded_signals.py",
            "recorded",
            "turns tables into arrays, with exclusions and noise",
            "RecordedLoads",
        ),
        FlowStep(
            "truing/estimation/sensor/contenders.py",
            "calibrations",
            "fits every model that the loads allow, predicts held-out cases",
            "SensorCalibrations",
        ),
        FlowStep(
            "truing/estimation/sensor/load_table.py", "load_table", "checks loads and signals of one fit", "LoadTable"
        ),
        FlowStep(
            "truing/estimation/sensor/calibrate.py",
            "fit_calibration",
            "fits the terms, weighted or with errors in both",
            "Calibration",
        ),
        FlowStep(
            "truing/estimation/sensor/calibration.py",
            "calibration_matrix",
            "computes G_B and its covariance from the terms",
            "MatrixEstimate",
        ),
        FlowStep(
            "stages/calibration/sensor_matrices.py",
            "matrix_rows",
            "writes every entry with unit and uncertainty",
            "sensor_matrix.parquet",
        ),
        FlowStep(
            "truing/report/sensor/calibration.py", "calibration", "shows G_B and the errors that remain", "report.html"
        ),
    ),
    "covariance": (
        FlowStep(
            "truing/formats/photographs.py",
            "list_photographs",
            "lists the photographs with pose and camera",
            "PhotographFiles",
        ),
        FlowStep(
            "truing/estimation/image_targets/photograph_targets.py",
            "measure_targets",
            "finds targets and measures their centres",
            "image points with covariance",
        ),
        FlowStep(
            "stages/image_tables/photographs.py",
            "read_photographs",
            "writes the image points of all photographs",
            "image_points.parquet",
        ),
        FlowStep(
            "stages/bundle_adjustment/rays_as_network.py",
            "named_network",
            "assembles cameras, rays and scale bars",
            "NamedNetwork",
        ),
        FlowStep(
            "truing/estimation/bundle/named_adjustment.py",
            "adjust_network",
            "calls the next four files in this order",
            "Network",
        ),
        FlowStep(
            "truing/estimation/bundle/start_values.py",
            "find_start",
            "orients every photograph approximately",
            "start values",
        ),
        FlowStep(
            "truing/estimation/bundle/data_snooping.py",
            "adjust_robustly",
            "adjusts, tests every ray, rejects gross errors",
            "accepted rays",
        ),
        FlowStep(
            "truing/estimation/bundle/adjustment.py",
            "adjust",
            "minimises the weighted squares of all rays",
            "Adjustment",
        ),
        FlowStep(
            "truing/estimation/bundle/bundle_covariance.py",
            "covariance",
            "computes the covariance of all unknowns in the datum",
            "BundleCovariance",
        ),
        FlowStep(
            "stages/bundle_adjustment/tables.py",
            "NetworkTables",
            "writes points, covariances and correlations",
            "object_points.parquet, point_correlations.parquet",
        ),
        FlowStep(
            "stages/ingestion/adjusted_points.py",
            "AdjustedPoints",
            "assigns each object point to its body",
            "observations.parquet",
        ),
        FlowStep(
            "truing/estimation/rigid_poses/correlated_poses.py",
            "with_correlations",
            "fits all bodies of a pose with correlated errors",
            "6x6 covariances",
        ),
        FlowStep(
            "stages/rigid_poses/pose_tables.py", "poses_table", "writes each pose with its covariance", "poses.parquet"
        ),
    ),
}


@cache
def imports() -> dict[str, set[str]]:
    """Packages that the modules of each package import, also inside functions and for types."""
    known = {package.name for package in PACKAGES}
    return {package.name: (_imported(ROOT / package.folder) & known) - {package.name} for package in PACKAGES}


def _imported(folder: Path) -> set[str]:
    nodes = (node for file in folder.rglob("*.py") for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    modules = (node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module)
    return {parts[1] for parts in (module.split(".") for module in modules) if parts[0] == "truing" and len(parts) > 1}


def shown_arrows(found: Mapping[str, set[str]]) -> list[tuple[str, str]]:
    """Imports without those that a longer way of imports implies: the arrows of the drawing."""
    row = {package.name: package.row for package in PACKAGES}
    down = {name: {target for target in targets if row[target] > row[name]} for name, targets in found.items()}
    return [
        (name, other)
        for name, targets in down.items()
        for other in sorted(targets)
        if not any(other in _reached(down, between) for between in targets - {other})
    ]


def _reached(down: Mapping[str, set[str]], start: str) -> set[str]:
    found: set[str] = set()
    waiting = [start]
    while waiting:
        fresh = down[waiting.pop()] - found
        found |= fresh
        waiting += fresh
    return found


_BOX = (190, 46)
_STEP = (222, 84)
_STYLE = (
    "<style>text{font-family:sans-serif;font-size:12px;fill:#1f2933}.name{font-weight:bold;font-size:13px}"
    ".small{font-size:11px;fill:#52606d}.file{font-family:monospace;font-size:12px}"
    ".box{fill:#f5f7fa;stroke:#0072b2}.line{stroke:#52606d;fill:none;marker-end:url(#head)}</style>"
    '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
    '<path d="M0,0 L8,4 L0,8 z" fill="#52606d"/></marker></defs>'
)


def _svg(width: float, height: float, title: str, parts: Iterable[str]) -> str:
    size = f'width="{width:g}" height="{height:g}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" {size}'
    frame = f'<rect {size} fill="#ffffff"/>'
    return "\n".join([f'{head} role="img"><title>{escape(title)}</title>', _STYLE, frame, *parts, "</svg>", ""])


def _place(package: Package) -> tuple[float, float]:
    """Centre of the upper edge of a box, px."""
    return 20 + _BOX[0] / 2 + package.column * _STEP[0], 16 + package.row * _STEP[1]


def packages_drawing(found: Mapping[str, set[str]]) -> str:
    """The packages as boxes; an arrow from a package to one that it imports."""
    at = {package.name: _place(package) for package in PACKAGES}
    parts = []
    for name, other in shown_arrows(found):
        (x0, y0), (x1, y1) = at[name], at[other]
        parts.append(f'<path class="line" d="M{x0:g},{y0 + _BOX[1]:g} L{x1 + _shift(x0, x1):g},{y1:g}"/>')
    if "estimation" in found["inference"] and "inference" in found["estimation"]:
        (x0, y0), (x1, _) = at["inference"], at["estimation"]
        ends = f"M{x0 + _BOX[0] / 2:g},{y0 + 18:g} L{x1 - _BOX[0] / 2:g},{y0 + 18:g}"
        back = f"M{x1 - _BOX[0] / 2:g},{y0 + 28:g} L{x0 + _BOX[0] / 2:g},{y0 + 28:g}"
        parts += [f'<path class="line" d="{ends}"/>', f'<path class="line" d="{back}"/>']
    for package in PACKAGES:
        x, y = at[package.name]
        parts += [
            f'<rect class="box" x="{x - _BOX[0] / 2:g}" y="{y:g}" width="{_BOX[0]}" height="{_BOX[1]}" rx="6"/>',
            f'<text class="name" x="{x:g}" y="{y + 19:g}" text-anchor="middle">{escape(package.name)}</text>',
            f'<text class="small" x="{x:g}" y="{y + 36:g}" text-anchor="middle">{escape(package.purpose)}</text>',
        ]
    return _svg(40 + 3 * _STEP[0] + _BOX[0], 32 + 7 * _STEP[1] + _BOX[1], "Packages and their imports", parts)


def _shift(x0: float, x1: float) -> float:
    """Distance of an arrow's end from the centre of its target, towards its source."""
    return max(-60.0, min(60.0, 0.25 * (x0 - x1)))


def flow_drawing(name: str) -> str:
    """The files of a flow from top to bottom; next to each arrow, the data that are passed on."""
    steps, height = FLOWS[name], 74
    parts = []
    for k, step in enumerate(steps):
        y = 12 + k * height
        parts += [
            f'<rect class="box" x="12" y="{y}" width="520" height="42" rx="5"/>',
            f'<text class="file" x="22" y="{y + 17}">{k + 1}  {escape(step.file)}</text>',
            f'<text class="small" x="22" y="{y + 34}">{escape(step.does)}</text>',
            f'<path class="line" d="M60,{y + 42} L60,{y + height - 1}"/>',
            f'<text class="file" x="74" y="{y + 62}">{escape(step.result)}</text>',
        ]
    return _svg(544, 12 + len(steps) * height + 4, f"Flow: {name}", parts)


def flow_table(name: str) -> str:
    """The numbered steps of a flow as a table with links to the files."""
    rows = [
        [str(k), f"[`{step.file}`](../{step.file})", f"`{step.name}`", step.does, step.result]
        for k, step in enumerate(FLOWS[name], 1)
    ]
    return table(["", "file", "name", "does", "result"], rows)


def imports_table(found: Mapping[str, set[str]]) -> str:
    """Each package with its folder and the packages that it imports."""
    rows = [
        [f"`{one.name}`", f"`{one.folder}/`", one.purpose, ", ".join(sorted(found[one.name])) or "none"]
        for one in PACKAGES
    ]
    return table(["package", "folder", "purpose", "imports"], rows)


def drawings() -> dict[str, str]:
    """The figures of the page by file name."""
    flows = {f"architecture-{name}.svg": flow_drawing(name) for name in FLOWS}
    return {"architecture-packages.svg": packages_drawing(imports()), **flows}


def tables() -> dict[str, str]:
    """The marked parts of the page by name."""
    return {"imports": imports_table(imports()), **{name: flow_table(name) for name in FLOWS}}


def main() -> None:
    """Write the figures, and the marked parts of the page."""
    for file, text in drawings().items():
        (FIGURES / file).write_text(text, encoding="utf-8")
    found = tables()
    renew(PAGE, {name: lambda name=name: found[name] for name in found})


if __name__ == "__main__":
    main()
