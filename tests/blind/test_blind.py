"""Effects are hidden in campaigns that were never seen before, and the whole pipeline must find and name them.

``TRUING_BLIND_SEED`` draws other campaigns. Rates are judged over all campaigns of a kind, never one by one: a correct
diagnosis fails a judgement once in a thousand draws.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import Effect, LinearDeformation, MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, Targets, telescope_geometry
from tests.blind.generator.schedule import at_rest, published_moves, random_moves
from tests.blind.judging import Judged, fewest_of, most_of, run_all

SEED = int(os.environ.get("TRUING_BLIND_SEED", "1"))
FALSE_ALARM = 0.05  # what the campaigns declare, by default, per campaign
DETECTION = 0.999  # of what stands out as clearly as here, dozens of its uncertainty
WITHIN_TWO_SIGMA = 0.9545

LAYOUTS: dict[str, Layout] = {
    "telescope": Layout(name="telescope-like"),
    "noisy": Layout(
        name="noisy",
        noise=Noise(point_mm=0.012, actuator_mm=0.002),
        faults=DataFaults(missing_share=0.1, gross_share=0.02),
        surroundings=Surroundings(shuffled=True),
    ),
    "other": Layout(
        name="other-geometry",
        geometry=telescope_geometry(
            base_radius=260.0,
            platform_radius=200.0,
            base_half_separation_deg=14.0,
            platform_half_separation_deg=8.0,
            length=420.0,
        ),
        targets=Targets(base=9, platform=7, per_leg=0, follow=0.3),
        noise=Noise(point_mm=0.008),
    ),
}


def nothing(layout: Layout, rng: np.random.Generator) -> list[Effect]:
    return []


def linear(layout: Layout, rng: np.random.Generator) -> list[Effect]:
    """Every leg its own kappa, from 0.008 to 0.03: 8 to 30 times its uncertainty at 5 um."""
    return [LinearDeformation(rng.choice([-1.0, 1.0]) * rng.uniform(0.008, 0.03, 6))]


def matrix(layout: Layout, rng: np.random.Generator) -> list[Effect]:
    """Entries of the size of the published ones."""
    return [MatrixDeformation(rng.normal(0.0, 0.012, (6, 6)))]


HIDDEN: dict[str, tuple[Callable[[Layout, np.random.Generator], list[Effect]], int]] = {
    "nothing": (nothing, 6),
    "linear": (linear, 3),
    "matrix": (matrix, 3),
}


def _write(kind: str, number: int, home: Path) -> Path:
    layout_name = list(LAYOUTS)[number % len(LAYOUTS)]
    layout = LAYOUTS[layout_name]
    seed = int(np.random.SeedSequence([SEED, list(HIDDEN).index(kind), number]).generate_state(1)[0])
    rng = np.random.default_rng(seed)
    moves = published_moves() if layout_name == "telescope" else random_moves(36, 8, rng)
    campaign = draw_campaign(layout, [at_rest(), *moves], HIDDEN[kind][0](layout, rng), rng)
    return write_campaign(campaign, home / f"{kind}-{number}-{layout_name}", seed)


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Judged]]:
    """All campaigns of all kinds, drawn, written and run."""
    home = tmp_path_factory.mktemp("blind")
    folders = [(kind, _write(kind, number, home)) for kind, (_, count) in HIDDEN.items() for number in range(count)]
    results = run_all([folder for _, folder in folders])
    return {kind: [r for (k, _), r in zip(folders, results, strict=True) if k == kind] for kind in HIDDEN}


def test_nothing_is_found_that_was_not_hidden(judged: dict[str, list[Judged]]) -> None:
    """At most the declared share of campaigns, whether anything is hidden in them or not."""
    campaigns = [campaign for kind in judged.values() for campaign in kind]
    alarms = {campaign.name: campaign.invented for campaign in campaigns if campaign.invented}
    assert len(alarms) <= most_of(len(campaigns), FALSE_ALARM), alarms


def test_what_was_hidden_is_found_and_named(judged: dict[str, list[Judged]]) -> None:
    campaigns = [campaign for kind in ("linear", "matrix") for campaign in judged[kind]]
    missed = {campaign.name: campaign.missed for campaign in campaigns if campaign.missed}
    assert len(campaigns) - len(missed) >= fewest_of(len(campaigns), DETECTION), missed


@pytest.mark.parametrize(
    ("kind", "cause"), [("linear", "platform-deformation-linear"), ("matrix", "platform-deformation-matrix")]
)
def test_the_stated_uncertainties_cover_the_truth(judged: dict[str, list[Judged]], kind: str, cause: str) -> None:
    found = [campaign for campaign in judged[kind] if not campaign.missed]
    assert found, "none was found, so none can be judged"
    pulls = np.concatenate([campaign.pulls(cause) for campaign in found])
    within = int(np.sum(np.abs(pulls) < 2))
    limits = fewest_of(len(pulls), WITHIN_TWO_SIGMA), most_of(len(pulls), WITHIN_TWO_SIGMA)
    assert limits[0] <= within <= limits[1], f"{within} of {len(pulls)} within two sigma, pulls {np.round(pulls, 1)}"
