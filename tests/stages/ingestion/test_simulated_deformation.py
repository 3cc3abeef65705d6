"""The simulated deformation in its three forms, and faults of its files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.faults import assert_fault
from tests.tolerance import assert_close
from truing.formats.faultlog import FaultLog
from truing.formats.source import CampaignFiles, raw_files
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import Fault
from truing.stages.ingestion.simulated_deformation import read_simulated_deformation
from truing.stages.responses.simulated_shifts import given_deformation

_K = np.array([[0.016, 0.0, -0.008], [0.001, 0.02, -0.017], [-0.002, -0.015, 0.014]])
_SIGMA = np.array([[0.001, 0.002, 0.003]] * 3)
_LEGS = [{"a_mm": [a, 0.0, 0.0], "b_mm": [a, 1.0, 0.0], "length_mm": 500.0} for a in (100.0, 0.0, -100.0)]
_MECHANISM = {"type": "ups", "legs": _LEGS, "deformation_file": "k.csv"}
_LINES = [" ".join(map(str, row)) for row in _K]
_ENTRIES = ["leg,column,coefficient,sigma"]
_ENTRIES += [f"{i + 1},{j + 1},{_K[i, j]},{_SIGMA[i, j]}" for i in range(3) for j in range(3)]
_NAMES = [f"delta_rho{i}_mm" for i in (1, 2, 3)] + [f"delta_bz{i}_um" for i in (1, 2, 3)]
_MOVED = np.array([[1.3, 0.0, 0.0], [0.0, 1.3, 0.0], [0.0, 0.0, 1.3], [1.0, -1.0, 0.5]])
_SHIFTS = [",".join(_NAMES), *(",".join(map(str, [*u, *(1e3 * _K @ u)])) for u in _MOVED)]


def _read(folder: Path, lines: list[str] | None) -> tuple[np.ndarray, np.ndarray] | list[Fault]:
    if lines is not None:
        (folder / "k.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    campaign = read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, "mechanism": _MECHANISM})
    log = FaultLog()
    table = read_simulated_deformation(CampaignFiles(folder, campaign), 3, log)
    if table is None:
        return list(log.faults())
    assert ARTIFACTS["given_deformation"].faults(table) == []
    assert not log
    return given_deformation(table)


@pytest.mark.parametrize(
    ("lines", "sigma"),
    [
        (_LINES, 0.0),
        (["# eq. 4", "rho1 rho2 rho3", *_LINES, ""], 0.0),
        ([line.replace(" ", "; ") for line in _LINES], 0.0),
        (_ENTRIES, _SIGMA),
        ([_ENTRIES[0], *_ENTRIES[:0:-1]], _SIGMA),
        (_SHIFTS[:4], 0.0),
        (_SHIFTS, 0.0),
    ],
)
def test_every_form_gives_the_same_matrix(tmp_path: Path, lines: list[str], sigma: object) -> None:
    entries, found = _read(tmp_path, lines)
    assert_close(entries, _K, atol=1e-9)
    assert_close(found, np.broadcast_to(np.asarray(sigma), (3, 3)), atol=1e-8)
    assert tmp_path / "k.csv" in raw_files(tmp_path, {"mechanism": _MECHANISM})  # so that a change of it is noticed


def test_the_noise_of_simulated_shifts_becomes_that_of_the_entries(tmp_path: Path) -> None:
    lines = [f"{_SHIFTS[0]},sigma_um", *(f"{line},1.3" for line in _SHIFTS[1:4])]
    assert_close(_read(tmp_path, lines)[1], np.full((3, 3), 1e-3), atol=1e-12)


@pytest.mark.parametrize(
    ("lines", "facts"),
    [
        (None, {"file": "campaign.toml", "column": "mechanism.deformation_file", "value": "k.csv"}),
        ([], {"row": None, "value": "0 rows"}),
        (_LINES[:2], {"row": None, "value": "2 rows"}),
        ([*_LINES[:2], "1 2"], {"row": 3, "value": "2 cells"}),
        ([*_LINES[:2], "-0.002 x 0.014"], {"row": 3, "column": "rho2", "value": "x"}),
        ([*_LINES[:2], "-2 -15 14"], {"value": "K32 = -15; is it in um per mm? Divide it by 1000"}),
        (_ENTRIES[:-1], {"value": "1 missing, such as leg 3, column 3"}),
        ([*_ENTRIES, "1,2,0.0,0.001"], {"row": 11, "value": "leg 1, column 2 again"}),
        ([*_ENTRIES[:-1], "4,3,0.014,0.001"], {"row": 10, "column": "leg", "value": "4"}),
        ([*_ENTRIES[:-1], "3,3,0.014,-0.001"], {"column": "sigma", "value": "-0.001"}),
        (["leg,column,sigma", "1,1,0.1"], {"value": "no coefficient"}),
        (["leg,column,coefficient,note", "1,1,0.1,0"], {"value": "note"}),
        (_SHIFTS[:3], {"value": "2 rows that determine 2 of 3"}),
        ([_SHIFTS[0], *(_SHIFTS[1],) * 5], {"value": "5 rows that determine 1 of 3"}),
        ([f"{_SHIFTS[0]},sigma_um", *(f"{line},0" for line in _SHIFTS[1:])], {"row": 2, "column": "sigma_um"}),
        ([_SHIFTS[0].replace("_um", "_mm"), *_SHIFTS[1:]], {}),
    ],
)
def test_a_fault_says_where_it_is(tmp_path: Path, lines: list[str] | None, facts: dict[str, object]) -> None:
    found = _read(tmp_path, lines)
    assert isinstance(found, list)
    assert_fault(found, **{"file": "k.csv", **facts})
