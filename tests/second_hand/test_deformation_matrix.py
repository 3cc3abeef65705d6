"""The measured K by command line, against a simulated one with wrong entries, and with large uncertainty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Targets
from tests.blind.generator.schedule import published_moves
from tests.blind.generator.telescope import PUBLISHED_K
from tests.second_hand.command import run
from tests.tolerance import assert_between

K = np.asarray(PUBLISHED_K)
LAYOUT = Layout(name="bent", targets=Targets(base=10, platform=10, per_leg=0), faults=DataFaults(0.0, 0.0))


def test_three_wrong_entries_of_a_simulated_matrix_differ_and_no_other(tmp_path: Path) -> None:
    campaign = draw_campaign(LAYOUT, published_moves(), [MatrixDeformation(K)], np.random.default_rng(21))
    folder = write_campaign(campaign, tmp_path / "c", 21)
    wrong = {(0, 0): 0.011, (2, 4): -0.012, (5, 1): 0.010}
    simulated = K.copy()
    for place, off in wrong.items():
        simulated[place] += off
    np.savetxt(folder / "k.csv", simulated)
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    (folder / "campaign.toml").write_text(text.replace("[mechanism]", '[mechanism]\ndeformation_file = "k.csv"', 1))
    found = run(folder, "deformation", tmp_path / "run")["simulated_deformation"].set_index(["leg", "column"])
    differ = {(leg - 1, column - 1) for leg, column in found.index[found["verdict"] == "differs"]}
    assert differ == set(wrong)
    off = np.array([wrong.get((leg - 1, column - 1), 0.0) for leg, column in found.index])
    squares = ((found["difference"].to_numpy() + off) / found["sigma"].to_numpy()) ** 2
    low, high = (float(chi2.ppf(q, 36)) for q in (1e-3, 1 - 1e-3))
    assert_between(squares.sum(), low, high, what="differences beyond the true ones")


@pytest.mark.parametrize("seed", [31, 32, 33])
def test_poses_held_out_of_hardly_more_poses_than_drives_are_no_gross_errors(tmp_path: Path, seed: int) -> None:
    """Eight poses fit six columns of K: its own sigma is a large part of what held-out shifts differ by."""
    moves = [(n, "verification" if n > 8 else role, move) for n, (_, role, move) in enumerate(published_moves()[:20])]
    campaign = draw_campaign(LAYOUT, moves, [MatrixDeformation(K)], np.random.default_rng(seed))
    tables = run(write_campaign(campaign, tmp_path / "c", seed), "deformation", tmp_path / "run")
    shifts = tables["deformation"].merge(tables["configurations"][["pose", "role"]], on="pose")
    held = shifts[shifts["role"] == "verification"]
    assert len(held) == 6 * 11
    assert not held["rejected"].any()  # 0.05 expected in a whole table
    entries = tables["deformation_models"].query("model == 'matrix'")
    z = (entries["coefficient"].to_numpy() - K.ravel()) / entries["sigma"].to_numpy()
    low, high = (float(chi2.ppf(q, 36)) for q in (1e-4, 1 - 1e-4))
    assert_between((z**2).sum(), low, high, what="entries of K")
