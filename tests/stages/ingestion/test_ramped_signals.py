"""Raw signals under a continuously changing load: the compliance is unbiased by the first samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.tolerance import assert_between, assert_close
from truing.pipeline.in_memory import stage_line

STEPS, SAMPLES, PACE = 24, 6, 10.0  # load per sample, N
COMPLIANCE = 4e-3  # um per N
WAVELENGTH_UM = 0.63299
HEAD = "run,step,time_s,load_axis,load,channel,signal_x,signal_y,material_temperature_c"


def ramp(folder: Path, *, transit: bool) -> Path:
    """A ramp up and down again, samples all along; where ``transit``, the last two of each step are under way, far off
    the line that the platform answers with."""
    up = np.arange(STEPS // 2 * SAMPLES) * PACE
    load = np.concatenate([up, up[::-1]])
    late = (np.arange(len(load)) % SAMPLES >= SAMPLES - 2) & transit
    length = COMPLIANCE * load + np.where(late, 0.05, 0.0)  # far below half a fringe: counting goes on
    phase = 4.0 * np.pi * length / WAVELENGTH_UM
    noise = np.random.default_rng(3).normal(0.0, 1.0, (2, len(load)))
    x, y = 400.0 * np.cos(phase) + noise[0], 400.0 * np.sin(phase) + noise[1]
    rows = [
        f"1,{n // SAMPLES},{n},fz,{load[n]:.6f},dz,{x[n]:.9f},{y[n]:.9f},{20.0 + 0.01 * n:.6f}"
        + (f",{int(late[n])}" if transit else "")
        for n in range(len(load))
    ]
    (folder / "quadrature.csv").write_text("\n".join([HEAD + ",transit" * transit, *rows]) + "\n")
    (folder / "campaign.toml").write_text(
        '[campaign]\nname = "ramp"\nkind = "interferometer"\n[interferometer]\nwavelength_nm = 632.99\n'
    )
    return folder


def test_on_a_ramp_load_time_and_temperature_are_means_of_the_readings_samples(tmp_path):
    table = stage_line(ramp(tmp_path, transit=False)).call("ingest").tables["readings"]
    step = np.arange(STEPS)
    middle = SAMPLES * step + 0.5 * (SAMPLES - 1)
    assert_close(table.column("time_s").to_numpy(), middle, atol=1e-9)
    assert_close(table.column("material_temperature_c").to_numpy(), 20.0 + 0.01 * middle, atol=1e-9)
    rising = PACE * middle[: STEPS // 2]
    assert_close(table.column("fz_n").to_numpy(), np.concatenate([rising, rising[::-1]]), atol=1e-6)


def test_the_compliance_of_a_ramp_is_within_its_sigma_of_the_truth(tmp_path):
    for transit in (False, True):
        folder = tmp_path / str(transit)
        folder.mkdir()
        line = stage_line(ramp(folder, transit=transit)).call("ingest").call("pose").call("deformation")
        rows = line.tables["compliance"].to_pylist()
        found = next(row for row in rows if (row["response"], row["load"]) == ("dz", "fz"))
        missed = found["coefficient"] - COMPLIANCE * 1e-6
        assert_between(found["sigma"] / (COMPLIANCE * 1e-6), 1e-6, 1e-2)
        assert abs(missed) < 4.0 * found["sigma"], (transit, missed, found["sigma"])
    assert line.tables["exclusions"].to_pylist()[0]["rows"] == 2 * STEPS
