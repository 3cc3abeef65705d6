"""Tables of docs/force-sensor-paper.md: the paper's equations and figures, computed again.

    python -m docs.experiments.force_sensor_paper

computes everything from docs/experiments/published_force_sensor.json and the sets of force_sensor_sets.py, draws
docs/figures/force-sensor-figure8.svg and -figure9.svg and renews the tables of docs/force-sensor-paper.md; some
twenty seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from docs.experiments import force_sensor_deformation as deformation
from docs.experiments import force_sensor_statics as statics
from docs.experiments import force_sensor_tolerances as tolerances
from docs.experiments.force_sensor_figures import draw
from docs.experiments.marked_tables import renew

DOCS = Path(__file__).resolve().parents[1]
PAGE = DOCS / "force-sensor-paper.md"
FIGURES = {"force-sensor-figure8.svg": 0, "force-sensor-figure9.svg": 1}
TABLES: dict[str, Callable[[], str]] = {
    "as-printed": deformation.as_printed,
    "conditions": statics.conditions,
    "sensitivities": statics.scaled_sensitivities,
    "twists": statics.twists,
    "bound": statics.bound,
    "gauges": statics.gauges,
    "sources": tolerances.sources,
    "leaders": tolerances.leaders,
    "sampling": tolerances.sampling,
    "ranking": tolerances.ranking,
    "table-2": deformation.table_2,
    "three-fold": deformation.three_fold_radii,
    "softest": deformation.softest,
    "prior": deformation.prior,
    "maxima": deformation.maxima,
    "along-z": deformation.along_z,
    "torques": deformation.torques,
    "synthetic": statics.synthetic,
    "arithmetic": deformation.arithmetic,
}


def main() -> None:
    """Renew the figures and the tables."""
    for name, kind in FIGURES.items():
        draw(DOCS / "figures" / name, kind)
    renew(PAGE, TABLES)


if __name__ == "__main__":
    main()
