"""The benchmark of large networks runs at its smallest size, and its residuals agree with the drawn noise."""

from __future__ import annotations

import re

from benchmarks.large_network import SMALLEST_SIZE, measure


def test_the_smallest_size_is_adjusted_to_its_noise(capsys):
    measure("smallest", SMALLEST_SIZE)
    output = capsys.readouterr().out
    sigma0 = re.search(r"sigma0 ([\d.]+)", output)
    rays = re.search(r"([\d,]+) rays", output)
    assert sigma0 is not None
    assert rays is not None
    redundancy = 2 * int(rays[1].replace(",", "")) - 3 * SMALLEST_SIZE[2] - 6 * SMALLEST_SIZE[0] * SMALLEST_SIZE[1]
    assert abs(float(sigma0[1]) - 1) < 4 / (2 * redundancy) ** 0.5 + 5e-4  # as printed
    assert "rounds of tests" in output
