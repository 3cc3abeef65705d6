"""The real telescope from its printed tables: bias of its calibration, and the inferred machine.

    python -m docs.experiments.telescope_report

computes everything from docs/experiments/published_telescope.json alone, draws docs/figures/telescope-report-*.svg and
renews the tables of docs/telescope-report.md. About two minutes, most of them for the rival numberings of the legs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from docs.experiments import telescope_report_statements as statements
from docs.experiments import telescope_report_tables as machine
from docs.experiments.marked_tables import renew
from docs.experiments.telescope_report_figures import draw_absorption, draw_flexure, draw_geometry, draw_remainder

DOCS = Path(__file__).resolve().parents[1]
PAGE = DOCS / "telescope-report.md"
TABLES: dict[str, Callable[[], str]] = {
    "shape": machine.shape,
    "variants": machine.variants,
    "rivals": machine.rival_numberings,
    "held-out": machine.legs_held_out,
    "misfit": machine.misfit,
    "checks": machine.checks,
    "absorption-5a": partial(machine.absorption, "5a"),
    "absorption-6a": partial(machine.absorption, "6a"),
    "kappa": machine.kappa_readings,
    "left-over": machine.left_over,
    "causes": machine.causes,
    "together": machine.together,
    "held-kappa": machine.held,
    "models": statements.models,
    "linear-models": statements.linear_models,
    "choice": statements.deformation_choice,
    "workspace": statements.workspace,
    "statements": statements.statements,
    "directions": statements.direction_choice,
    "references": statements.reference_readings,
    "stiffnesses": statements.stiffnesses,
    "rows-of-K": statements.rows_from_poses,
    "starts": statements.many_starts,
}


def main() -> None:
    """Renew the figures and the tables."""
    figures = DOCS / "figures"
    draw_absorption(figures / "telescope-report-absorption.svg")
    draw_geometry(figures / "telescope-report-geometry.svg")
    draw_flexure(figures / "telescope-report-flexure.svg")
    draw_remainder(figures / "telescope-report-remainder.svg", machine.BY)
    renew(PAGE, TABLES)


if __name__ == "__main__":
    main()
