"""How often the QA stage fails good campaigns: ``python -m benchmarks.quality_checks [campaigns]``.

Campaigns are drawn by the generator of the blind tests in three layouts (the telescope's; noisy, with targets missing
and gross errors; another geometry), with nothing hidden or with a deforming platform. A good campaign should fail in at
most one case in a hundred.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.stats import beta

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.schedule import at_rest, published_moves, random_moves
from tests.blind.test_blind import LAYOUTS
from tests.stages.line import run_line


def main(campaigns: int) -> None:
    failed: Counter[str] = Counter()
    warned: Counter[str] = Counter()
    for number in range(campaigns):
        verdicts = _judged(number)
        failed.update({check for check, verdict in verdicts if verdict == "fail"} or {"none"})
        warned.update({check for check, verdict in verdicts if verdict == "warn"})
    trips = campaigns - failed["none"]
    bound = beta.ppf(0.975, trips + 1, campaigns - trips)
    sys.stdout.write(f"{trips} of {campaigns} good campaigns failed (at most {100 * bound:.1f} % at 97.5 %)\n")
    for name, counts in (("fails", failed), ("warns", warned)):
        for check, count in counts.most_common():
            if check != "none":
                sys.stdout.write(f"  {check} {name} in {count}\n")


def _judged(number: int) -> set[tuple[str, str]]:
    layout = list(LAYOUTS.values())[number % len(LAYOUTS)]
    rng = np.random.default_rng([7, number])
    moves = published_moves() if layout.name == "telescope-like" else random_moves(36, 8, rng)
    hidden = [MatrixDeformation(0.01 * rng.standard_normal((6, 6)))] if number % 2 else []
    with tempfile.TemporaryDirectory() as home:
        campaign = draw_campaign(layout, [at_rest(), *moves], hidden, rng)
        folder = write_campaign(campaign, Path(home) / "campaign", number)
        qa = run_line(folder, "ingest", "qa")[0]["qa"].to_pandas()
    return set(zip(qa["check"], qa["verdict"], strict=True))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 700)
