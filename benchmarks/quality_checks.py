"""Share of good campaigns that the QA stage fails: ``python -m benchmarks.quality_checks [campaigns]``.

Campaigns are drawn by the generator of the blind tests. Of points: three layouts (the telescope's; noisy, with targets
missing and gross errors; another geometry), with nothing hidden or with a deforming platform. Of loads: all layouts of
a force sensor's bench, with nothing hidden or with a platform or loads that are not as simulated. A good campaign
should fail in at most one case in a hundred.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.stats import beta

from benchmarks.rows import Row, record_row
from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.draw import LAYOUTS
from tests.blind.generator.effects import MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.schedule import at_rest, published_moves, random_moves
from tests.blind.generator.sensor import campaign as sensor_campaign
from tests.blind.generator.sensor import effects as of_sensor
from tests.blind.generator.sensor import folder as sensor_folder
from tests.blind.generator.sensor import recording
from tests.blind.generator.sensor.draw import LAYOUTS as BENCHES
from tests.blind.generator.sensor.draw import draw_plan
from tests.stages.line import run_line

SMALLEST = ("1",)
OF_POINTS = ("telescope", "noisy", "other")
Verdicts = set[tuple[str, str]]
FX, FZ = 0, 2
# What a sensor may do without anything being wrong with its measurement.
PECULIAR: tuple[of_sensor.Effect, ...] = (
    of_sensor.LoadEccentricity(FZ, (0.01, 0.0, 0.0)),
    of_sensor.LoadImbalance(FZ, (0.0,) * 6, (0.0, 0.0, 0.0, 0.0, 0.01, 0.0)),
    of_sensor.StiffnessScale(FZ, 0.05),
    of_sensor.StiffnessAsymmetry(FZ, 0.03),
    of_sensor.StiffnessNonlinear(FZ, 0.02, along_only=True),
    of_sensor.Hysteresis(FZ, 0.02),
    of_sensor.JointClearance(FZ, 5e-6),
    of_sensor.Creep(tuple(range(6)), 0.02, 300.0),
    recording.CosineError(FX, 0.02, recording.across(FX, 0.4)),
    recording.AbbeOffset(FZ, (0.02, 0.03, 0.0)),
)


def main(campaigns: int) -> None:
    for kind, judge in (("points", _judged_points), ("loads", _judged_loads)):
        sys.stdout.write(f"{kind}: ")
        _report(kind, campaigns, judge)


def _report(kind: str, campaigns: int, judge: Callable[[int], Verdicts]) -> None:
    failed: Counter[str] = Counter()
    warned: Counter[str] = Counter()
    for number in range(campaigns):
        verdicts = judge(number)
        failed.update({check for check, verdict in verdicts if verdict == "fail"} or {"none"})
        warned.update({check for check, verdict in verdicts if verdict == "warn"})
    trips = campaigns - failed["none"]
    record_row(
        Row(f"good campaigns of {kind} that fail a check, of {campaigns}", 100 * trips / campaigns, "%", limit=1.0)
    )
    bound = beta.ppf(0.975, trips + 1, campaigns - trips)
    sys.stdout.write(f"{trips} of {campaigns} good campaigns failed (at most {100 * bound:.1f} % at 97.5 %)\n")
    for name, counts in (("fails", failed), ("warns", warned)):
        for check, count in counts.most_common():
            if check != "none":
                sys.stdout.write(f"  {check} {name} in {count}\n")


def _judged_points(number: int) -> Verdicts:
    kind = OF_POINTS[number % len(OF_POINTS)]
    rng = np.random.default_rng([7, number])
    layout = LAYOUTS[kind](rng)
    moves = published_moves() if kind == "telescope" else random_moves(36, 8, rng)
    hidden = [MatrixDeformation(0.01 * rng.standard_normal((6, 6)))] if number % 2 else []
    with tempfile.TemporaryDirectory() as home:
        campaign = draw_campaign(layout, [at_rest(), *moves], hidden, rng)
        return _verdicts(write_campaign(campaign, Path(home) / "campaign", number))


def _judged_loads(number: int) -> Verdicts:
    layout = draw_plan(list(BENCHES)[number % len(BENCHES)], frozenset(), number).layout
    hidden = [PECULIAR[number // 2 % len(PECULIAR)]] if number % 2 else []
    campaign = sensor_campaign.draw_campaign(layout, hidden, np.random.default_rng([8, number]))
    with tempfile.TemporaryDirectory() as home:
        return _verdicts(sensor_folder.write_campaign(campaign, Path(home) / "campaign", number))


def _verdicts(folder: Path) -> Verdicts:
    qa = run_line(folder, "ingest", "qa")[0]["qa"].to_pandas()
    return set(zip(qa["check"], qa["verdict"], strict=True))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 700)
