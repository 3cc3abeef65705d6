"""Printed values of the telescope report as arrays; published_telescope.json names the table of each."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FILE = Path(__file__).with_name("published_telescope.json")
LENGTHS = ("a_x", "a_y", "b_x", "b_y", "l")


@dataclass(frozen=True)
class Published:
    """Numbers in print. Table rows are (6,), legs 1 to 6, identified minus nominal: mm, u_x and kappa 1."""

    K: NDArray  # (6, 6), eq. 4
    calibration: NDArray  # (40, 6) m, Table 3: displacements of the actuators
    verification: NDArray  # (6, 6) m, Table 4
    tables: dict[str, dict[str, NDArray]]  # "5a": {"a_x": ...}
    workspace: NDArray  # (5,) half widths of x, y, z (m) and theta_x, theta_y (rad), Table 1
    stated: dict[str, float]  # in the units that the file names

    @property
    def own(self) -> NDArray:
        """Return the diagonal part (6, 6) of K, each attachment following its own actuator."""
        return np.diag(np.diag(self.K))

    def kappa(self, table: str) -> NDArray:
        """Return kappa (6,) of Table 6 or 7 itself: counted from 0.011 in Table 6, from K_ii in Table 7."""
        nominal = self.stated["kappa_initial"] if table.startswith("6") else np.diag(self.K)
        return nominal + self.tables[table]["kappa"]

    def moved(self, table: str) -> dict[str, NDArray]:
        """Return the differences of a fit of Table 5 or 6 from its fit with the whole of K (Table 7), by row."""
        whole = f"7{table[1]}"
        rows = {name: self.tables[table][name] - self.tables[whole][name] for name in LENGTHS}
        if table.startswith("5"):
            return {**rows, "u_x": self.tables[table]["u_x"]}
        return {**rows, "kappa": self.kappa(table) - self.kappa(whole)}


@cache
def published() -> Published:
    """Read the file."""
    print_ = json.loads(FILE.read_text(encoding="utf-8"))
    stated = {name: float(entry["value"]) for name, entry in print_["stated"].items()}
    reach = 1e-3 * stated["actuator_half_range"]
    levels = (print_[f"{role}_configurations"]["by_actuator"] for role in ("calibration", "verification"))
    calibration, verification = (reach * np.array(table, float).T for table in levels)
    half = 0.5 * np.array(print_["workspace"]["width"], float)
    workspace = half * np.array([1e-3, 1e-3, 1e-3, np.pi / 180, np.pi / 180])
    tables = {entry["print"].removeprefix("Table "): _rows(entry) for entry in print_["identified_minus_nominal"]}
    return Published(1e-3 * np.array(print_["K"]["rows"]), calibration, verification, tables, workspace, stated)


def _rows(entry: dict[str, Any]) -> dict[str, NDArray]:
    scale = {"kappa": 1e-3}
    return {name: scale.get(name, 1.0) * np.array(row) for name, row in entry["rows"].items()}
