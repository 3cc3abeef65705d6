"""Slips in the files of a campaign of object points on a legged mechanism; shares no code with what finds them."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tomli_w


@dataclass
class Files:
    """A campaign's files in memory: campaign.toml, configurations, points and survey."""

    toml: dict[str, Any]
    configurations: pd.DataFrame
    points: pd.DataFrame
    targets: pd.DataFrame

    @property
    def rho(self) -> list[str]:
        """The columns of readings, in leg order."""
        return [name for name in self.configurations.columns if name.startswith("rho")]

    def legs(self, change: Callable[[dict[str, Any]], None]) -> None:
        """Change every leg of [mechanism]."""
        for leg in self.toml["mechanism"]["legs"]:
            change(leg)


@dataclass(frozen=True)
class PointSlip:
    """A slip by name, the kind that it should be found as, and what it does to the files."""

    name: str
    kind: str
    make: Callable[[Files], None]
    relation: str = "readings-against-poses"


def read_files(folder: Path) -> Files:
    """Read a campaign folder whose tables are plain CSV."""
    toml = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))
    tables = (pd.read_csv(folder / f"{name}.csv") for name in ("configurations", "points", "targets"))
    return Files(toml, *tables)


def write_files(files: Files, folder: Path) -> Path:
    """Write a campaign folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / "campaign.toml").write_text(tomli_w.dumps(files.toml), encoding="utf-8")
    for name in ("configurations", "points", "targets"):
        getattr(files, name).to_csv(folder / f"{name}.csv", index=False)
    return folder


def _readings(factor: float, *legs: int) -> Callable[[Files], None]:
    def make(files: Files) -> None:
        names = [files.rho[leg] for leg in legs] or files.rho
        files.configurations[names] *= factor

    return make


def _columns(order: Callable[[list[str]], list[str]]) -> Callable[[Files], None]:
    def make(files: Files) -> None:
        files.configurations[files.rho] = files.configurations[order(files.rho)].to_numpy()

    return make


def _rows(order: Callable[[np.ndarray], np.ndarray]) -> Callable[[Files], None]:
    def make(files: Files) -> None:
        rows = order(np.arange(len(files.configurations)))
        files.configurations[files.rho] = files.configurations[files.rho].to_numpy()[rows]

    return make


def _exchange(rows: np.ndarray) -> np.ndarray:
    """Two poses far apart in the table are in each other's row."""
    i, j = len(rows) // 3, 2 * len(rows) // 3
    rows[[i, j]] = rows[[j, i]]
    return rows


def _missing_row(rows: np.ndarray) -> np.ndarray:
    """A row was lost halfway, all later ones moved up."""
    half = len(rows) // 2
    return np.r_[rows[:half], rows[half + 1 :], rows[half]]


def _scaled_leg(key: str, factor: float) -> Callable[[Files], None]:
    def change(leg: dict[str, Any]) -> None:
        leg[key] = [factor * c for c in leg[key]] if isinstance(leg[key], list) else factor * leg[key]

    return lambda files: files.legs(change)


def _swap_ab(files: Files) -> None:
    def change(leg: dict[str, Any]) -> None:
        leg["a_mm"], leg["b_mm"] = leg["b_mm"], leg["a_mm"]

    files.legs(change)


def _one_length(files: Files) -> None:
    files.toml["mechanism"]["legs"][2]["length_mm"] *= 0.1


def _mirror_everything(files: Files) -> None:
    files.points["y_mm"] *= -1.0
    files.targets["y_mm"] *= -1.0


def _mirror_points(files: Files) -> None:
    files.points["x_mm"] *= -1.0


def _mirror_survey(files: Files) -> None:
    files.targets.loc[files.targets["body"] == "platform", "x_mm"] *= -1.0


def _exchange_bodies(files: Files) -> None:
    for table in (files.points, files.targets):
        table["body"] = table["body"].replace({"base": "platform", "platform": "base"})
        table["leg"] = np.nan if "leg" in table else None
    files.points = files.points.drop(columns="leg")


def _scale_points(factor: float, *tables: str) -> Callable[[Files], None]:
    def make(files: Files) -> None:
        for name in tables:
            getattr(files, name)[["x_mm", "y_mm", "z_mm"]] *= factor

    return make


def _from_reference(files: Files) -> None:
    """Readings are counted from the reference configuration, where rho0_mm stands in the description."""
    zero = np.array([leg.get("rho0_mm", 0.0) for leg in files.toml["mechanism"]["legs"]])
    files.configurations[files.rho] -= zero


def _whole_lengths(files: Files) -> None:
    """Readings are whole lengths of the legs."""
    files.configurations[files.rho] += np.array([leg["length_mm"] for leg in files.toml["mechanism"]["legs"]])


def _freeze(files: Files) -> None:
    rows = np.arange(len(files.configurations)) >= len(files.configurations) // 2
    name = files.rho[3]
    files.configurations.loc[rows, name] = files.configurations[name].to_numpy()[rows][0]


def _frozen_column(files: Files) -> None:
    files.configurations[files.rho[1]] = files.configurations[files.rho[1]].to_numpy()[0]


def _copy_pose(files: Files) -> None:
    poses = files.configurations["pose"].tolist()
    source, goal = poses[len(poses) // 4], poses[3 * len(poses) // 4]
    kept = files.points[files.points["pose"] != goal]
    files.points = pd.concat([kept, kept[kept["pose"] == source].assign(pose=goal)])


def _frozen_instrument(files: Files) -> None:
    poses = files.configurations["pose"].tolist()
    first, later = poses[len(poses) // 2], poses[len(poses) // 2 + 1 :]
    kept = files.points[~files.points["pose"].isin(later)]
    copies = [kept[kept["pose"] == first].assign(pose=pose) for pose in later]
    files.points = pd.concat([kept, *copies])


def _parallel(files: Files) -> None:
    files.legs(lambda leg: leg.update(a_mm=[leg["b_mm"][0], leg["b_mm"][1], leg["a_mm"][2]]))


def _exchange_points(files: Files) -> None:
    poses = files.configurations["pose"].tolist()
    i, j = poses[len(poses) // 3], poses[len(poses) // 2]
    files.points["pose"] = files.points["pose"].replace({i: j, j: i})


def _misread(files: Files) -> None:
    """Two digits of one reading change places."""
    name, row = files.rho[0], files.configurations.index[5]
    away = 1.0 if files.configurations.loc[row, name] < files.configurations[name].median() else -1.0
    files.configurations.loc[row, name] += 1.8 * away * _large(files)


def _large(files: Files) -> float:
    """A third of the range of the readings, mm."""
    return float(np.ptp(files.configurations[files.rho].to_numpy())) / 3.0


def _half(change: Callable[[Files, np.ndarray], None]) -> Callable[[Files], None]:
    """A change in the second half of the rows of configurations."""
    return lambda files: change(files, np.arange(len(files.configurations)) >= len(files.configurations) // 2)


def _half_sign(files: Files, rows: np.ndarray) -> None:
    files.configurations.loc[rows, files.rho] *= -1.0


def _half_inch(files: Files, rows: np.ndarray) -> None:
    files.configurations.loc[rows, files.rho] /= 25.4


def _half_exchanged(files: Files, rows: np.ndarray) -> None:
    one, two = files.rho[0], files.rho[2]
    files.configurations.loc[rows, [one, two]] = files.configurations.loc[rows, [two, one]].to_numpy()


Rows = Callable[[np.ndarray], np.ndarray]
Change = Callable[[Files, np.ndarray], None]


def stretch_of_rows(rows: np.ndarray) -> np.ndarray:
    """The second third of the rows."""
    return (rows >= len(rows) // 4) & (rows < len(rows) * 3 // 5)


def _two_stretches(rows: np.ndarray) -> np.ndarray:
    """Two days out of five."""
    day = 5 * rows // len(rows)
    return (day == 1) | (day == 3)


def _in_rows(chosen: Rows, change: Change) -> Callable[[Files], None]:
    """A change in some rows of configurations."""
    return lambda files: change(files, chosen(np.arange(len(files.configurations))))


def _on_a_day(change: Change) -> Callable[[Files], None]:
    """A change in all rows of one day; the days are written down in a column, and alternate."""

    def make(files: Files) -> None:
        day = 1 + np.arange(len(files.configurations)) // 3 % 3
        files.configurations["day"] = day
        change(files, day == 2)

    return make


def _some_sign(files: Files, rows: np.ndarray) -> None:
    files.configurations.loc[rows, files.rho[1]] *= -1.0


def _some_shifted(files: Files, rows: np.ndarray) -> None:
    """Shift the readings of some rows by one row, the last of them to the first."""
    at = np.flatnonzero(rows)
    values = files.configurations[files.rho].to_numpy().copy()
    values[at] = values[np.roll(at, 1)]
    files.configurations[files.rho] = values


def _copied_column(files: Files) -> None:
    files.configurations[files.rho[2]] = files.configurations[files.rho[1]]


def _poses_in_m(files: Files) -> None:
    poses = files.configurations["pose"].tolist()[3:6]
    files.points.loc[files.points["pose"].isin(poses), ["x_mm", "y_mm", "z_mm"]] *= 1e-3


def _survey_of_another(files: Files) -> None:
    own = files.targets["body"].eq("base")
    other = files.targets.loc[files.targets["body"].eq("platform"), ["x_mm", "y_mm", "z_mm"]].to_numpy()
    count = min(int(own.sum()), len(other))
    places = np.flatnonzero(own)[:count]
    files.targets.iloc[places, files.targets.columns.get_indexer(["x_mm", "y_mm", "z_mm"])] = other[:count]


def _in_steps(step: float, *, points: bool) -> Callable[[Files], None]:
    """Numbers of readings or points that were written down in steps, mm."""

    def make(files: Files) -> None:
        table = files.points if points else files.configurations
        names = ["x_mm", "y_mm", "z_mm"] if points else files.rho
        table[names] = ((table[names] / step).round() * step).round(6)

    return make


# What is no more than a warning.
ROUNDED_SLIPS = (
    PointSlip("readings in steps", "rounded", _in_steps(0.13, points=False)),
    PointSlip("points in steps", "rounded", _in_steps(0.13, points=True), "points-against-survey"),
)
READING_SLIPS = (
    PointSlip("readings in m", "unit", _readings(1e-3)),
    PointSlip("readings in inches", "unit", _readings(1 / 25.4)),
    PointSlip("readings in um", "unit", _readings(1e3)),
    PointSlip("readings in cm", "unit", _readings(0.1)),
    PointSlip("readings in degrees of a spindle", "unit", _readings(360.0 / 0.7)),
    PointSlip("one reading in m", "unit", _readings(1e-3, 4)),
    PointSlip("sign of all readings", "sign", _readings(-1.0)),
    PointSlip("sign of one reading", "sign", _readings(-1.0, 0)),
    PointSlip("columns rotated", "columns-exchanged", _columns(lambda names: names[1:] + names[:1])),
    PointSlip("columns reversed", "columns-exchanged", _columns(lambda names: names[::-1])),
    PointSlip("two columns exchanged", "columns-exchanged", _columns(lambda n: [n[0], n[2], n[1], *n[3:]])),
    PointSlip("two far columns exchanged", "columns-exchanged", _columns(lambda n: [n[4], *n[1:4], n[0], *n[5:]])),
    PointSlip("rows shifted down", "rows-shifted", _rows(lambda rows: np.roll(rows, 1))),
    PointSlip("rows shifted up by two", "rows-shifted", _rows(lambda rows: np.roll(rows, -2))),
    PointSlip("a row lost halfway", "rows-exchanged", _rows(_missing_row)),
    PointSlip("rows reversed", "rows-exchanged", _rows(lambda rows: rows[::-1])),
    PointSlip("two rows exchanged", "rows-exchanged", _rows(_exchange)),
    PointSlip("points of two poses exchanged", "rows-exchanged", _exchange_points),
    PointSlip("readings from the reference", "zero", _from_reference),
    PointSlip("readings as whole lengths", "zero", _whole_lengths),
    PointSlip("a misread digit", "stray", _misread),
    PointSlip("sign of half the rows", "sign", _half(_half_sign)),
    PointSlip("half the rows in inches", "unit", _half(_half_inch)),
    PointSlip("columns exchanged in half the rows", "columns-exchanged", _half(_half_exchanged)),
    PointSlip("a column twice", "copied", _copied_column),
    PointSlip("a column frozen", "frozen", _frozen_column),
    PointSlip("a column frozen halfway", "frozen", _freeze),
)
PART_SLIPS = (
    PointSlip("sign in a stretch", "sign", _in_rows(stretch_of_rows, _half_sign)),
    PointSlip("sign of one reading in a stretch", "sign", _in_rows(stretch_of_rows, _some_sign)),
    PointSlip("inches in a stretch", "unit", _in_rows(stretch_of_rows, _half_inch)),
    PointSlip("columns exchanged in a stretch", "columns-exchanged", _in_rows(stretch_of_rows, _half_exchanged)),
    PointSlip("rows shifted in a stretch", "rows-shifted", _in_rows(stretch_of_rows, _some_shifted)),
    PointSlip("inches in every second row", "unit", _in_rows(lambda rows: rows % 2 == 1, _half_inch)),
    PointSlip("sign in every second row", "sign", _in_rows(lambda rows: rows % 2 == 1, _half_sign)),
    PointSlip(
        "columns exchanged in every third row", "columns-exchanged", _in_rows(lambda r: r % 3 == 0, _half_exchanged)
    ),
    PointSlip("sign in two stretches", "sign", _in_rows(_two_stretches, _half_sign)),
    PointSlip("columns exchanged in two stretches", "columns-exchanged", _in_rows(_two_stretches, _half_exchanged)),
    PointSlip("inches on a day", "unit", _on_a_day(_half_inch)),
    PointSlip("columns exchanged on a day", "columns-exchanged", _on_a_day(_half_exchanged)),
)
DESCRIPTION_SLIPS = (
    PointSlip("a and b exchanged", "parts-exchanged", _swap_ab),
    PointSlip("u downwards", "direction-reversed", lambda files: _scaled_leg("u", -1.0)(files)),
    PointSlip("lengths ten times too small", "unit", _scaled_leg("length_mm", 0.1)),
    PointSlip("one length ten times too small", "unit", _one_length),
    PointSlip("lengths in inches", "unit", _scaled_leg("length_mm", 1 / 25.4)),
    PointSlip("a in m", "unit", _scaled_leg("a_mm", 1e-3)),
    PointSlip("points and survey mirrored", "mirrored", _mirror_everything),
    PointSlip("points and survey in m", "unit", _scale_points(1e-3, "points", "targets")),
    PointSlip("points and survey in inches", "unit", _scale_points(1 / 25.4, "points", "targets")),
    PointSlip("bodies exchanged", "parts-exchanged", _exchange_bodies),
    PointSlip("legs parallel", "", _parallel, "legs-regular"),
)
POINT_SLIPS = (
    PointSlip("points mirrored", "mirrored", _mirror_points, "points-against-survey"),
    PointSlip("survey of the platform mirrored", "mirrored", _mirror_survey, "points-against-survey"),
    PointSlip("points in m", "unit", _scale_points(1e-3, "points"), "points-against-survey"),
    PointSlip("survey in inches", "unit", _scale_points(1 / 25.4, "targets"), "points-against-survey"),
    PointSlip("points of three poses in m", "unit", _poses_in_m, "points-against-survey"),
    PointSlip("survey of another body", "", _survey_of_another, "points-against-survey"),
    PointSlip("a pose copied", "copied", _copy_pose, "copied-poses"),
    PointSlip("instrument frozen halfway", "copied", _frozen_instrument, "copied-poses"),
)
ALL_SLIPS = (*READING_SLIPS, *PART_SLIPS, *DESCRIPTION_SLIPS, *POINT_SLIPS)
