"""``python -m docs.experiments.foreign_limit``: how many inputs of foreign effects could be named at best.

Each effect acts alone, as a course over the poses with independent noise: its pattern, size and noise are known. Sets
of inputs are compared by Bayes' rule with the generator's own prior, as is an effect that follows no column. No method
can name more inputs with the same certainty.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from benchmarks.blind import FOREIGN, INSTRUMENTS, drawn
from tests.blind.generator.case import Case, Measure
from tests.blind.generator.foreign import Foreign, ForeignDrives, ForeignField, _input
from tests.blind.generator.quaternions import Array
from tests.blind.generator.smooth import LENGTH_SCALES, random_function, standardised

SEED, CAMPAIGNS, DRAWS = 331177, 40, 24
FOLLOWS_NOTHING, NAMED = 0.4, 0.9  # prior of an effect without a column; probability from which an input is named
Inputs = tuple[str, ...]


def covariances(inputs: Array, rng: np.random.Generator) -> list[Array]:
    """Covariances (N, N), of unit mean variance, of the generator's functions of inputs (N, D), by drawn length
    scales."""
    scaled = standardised(inputs)
    plane = np.column_stack([np.ones(len(scaled)), scaled])
    rest = np.eye(len(scaled)) - plane @ np.linalg.pinv(plane)
    found = []
    for _ in range(DRAWS):
        apart = scaled / rng.uniform(*LENGTH_SCALES, scaled.shape[1])
        kernel = rest @ np.exp(-0.5 * np.sum((apart[:, None] - apart) ** 2, -1)) @ rest
        if np.trace(kernel) > 1e-6 * len(kernel):
            found.append(kernel * len(kernel) / np.trace(kernel))
    return found


def prior(columns: list[str]) -> dict[Inputs, float]:
    """Probability of every set of inputs, as the generator draws it."""
    readings = [name for name in columns if name.startswith("rho")]
    others = [name for name in columns if not name.startswith("rho")]
    pairs = list(combinations(readings, 2))
    drives = {(name,): 0.5 / len(readings) for name in readings} | dict.fromkeys(pairs, 0.5 / len(pairs))
    found = {(other,): 0.25 / len(others) for other in others}
    for own, share in drives.items():
        found[own] = 0.5 * share
        found |= {(*own, other): 0.25 * share / len(others) for other in others}
    return found


def log_density(courses: Array, covariance: Array, variance: float) -> float:
    """Log density of courses (N, C) of a size in noise of unit variance, but for a constant."""
    values, vectors = np.linalg.eigh(covariance)
    total = 1.0 + variance * np.maximum(values, 0.0)
    along = vectors.T @ courses
    return float(-0.5 * courses.shape[1] * np.sum(np.log(total)) - 0.5 * np.sum(along**2 / total[:, None]))


def named(courses: Array, size: float, columns: Mapping[str, Array], rng: np.random.Generator) -> set[str]:
    """The inputs that courses (N, C) of a signal-to-noise ratio follow with a probability of at least 0.9."""
    count, width = courses.shape
    variance, odds = size**2 / width / count, dict[Inputs, float]()
    for own, share in prior(list(columns)).items():
        each = [
            log_density(courses, kernel, variance)
            for kernel in covariances(np.column_stack([columns[name] for name in own]), rng)
        ]
        if each:
            odds[own] = np.log((1.0 - FOLLOWS_NOTHING) * share) + np.logaddexp.reduce(each) - np.log(len(each))
    odds[()] = np.log(FOLLOWS_NOTHING) + log_density(courses, np.eye(count) - 1.0 / count, variance)
    every = np.logaddexp.reduce(list(odds.values()))
    return {
        name
        for name in columns
        if np.exp(np.logaddexp.reduce([own for inputs, own in odds.items() if name in inputs]) - every) >= NAMED
    }


def effects(case: Case, rng: np.random.Generator) -> Iterator[tuple[Foreign, set[str]]]:
    """The effects of a case that are functions of columns, each with the inputs that are named."""
    campaign = case.plan.campaign()
    fitted = np.array(campaign.schedule.role) != "verification"
    setting, drho = Measure(case.plan)._setting, campaign.truth.drho
    names = [f"rho{k + 1}_mm" for k in range(drho.shape[1])]
    names += ["time_s", "temperature_c", *campaign.schedule.further]
    columns = {name: _input(name, drho, setting)[fitted] for name in names}
    for effect, size in zip(case.effects, case.strengths, strict=True):
        if not isinstance(effect, (ForeignDrives, ForeignField)):
            continue
        inputs = np.column_stack([_input(name, drho, setting) for name in effect.inputs])
        seeds = [effect.seed + leg for leg in effect.legs] if isinstance(effect, ForeignDrives) else [effect.seed]
        course = np.column_stack([random_function(inputs, seed) for seed in seeds])[fitted]
        course = course - course.mean(0)
        seen = size * course / np.linalg.norm(course) + rng.normal(size=course.shape)
        yield effect, named(seen - seen.mean(0), size, columns, rng)


def main() -> None:
    """Print the table of docs/foreign-worlds.md."""
    rng, found = np.random.default_rng(0), list[tuple[int, bool]]()
    for number in range(CAMPAIGNS):
        one = drawn(number, SEED, group=FOREIGN)
        try:
            case = INSTRUMENTS[one.instrument].hide(one.names, one.layout, one.strength, one.seed)
        except ValueError:  # what a layout does not show cannot be hidden in it
            continue
        assert isinstance(case, Case)
        for effect, told in effects(case, rng):
            inputs = set(effect.drivers)
            found.append((len(inputs), inputs <= told))
    counts = np.array(found)
    for size in (1, 2, 3):
        own = counts[counts[:, 0] == size, 1]
        sys.stdout.write(f"| {size} | {len(own)} | {100.0 * own.mean():.0f} % |\n")
    sys.stdout.write(f"| all | {len(counts)} | {100.0 * counts[:, 1].mean():.0f} % |\n")


if __name__ == "__main__":
    main()
