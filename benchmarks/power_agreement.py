"""Benchmark of `truing power` against diagnoses of campaigns from the independent generator.

    python -m benchmarks.power_agreement [--draws 4] [--seed 1] [--results FILE] [--write]

The same effect is hidden in the same layout twice: by what `truing power` simulates, and by the generator of the blind
tests, which shares no code with truing. The same diagnosis is run on both. Campaigns are drawn from the seed and their
own numbers, so that a run that was cut short goes on where it stopped; results are kept line by line in FILE.
``--write`` makes tables and figure of docs/power.md anew from it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np

from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, Targets
from tests.blind.hidden_twice import CAUSES, Ground
from truing.pipeline.power_command import diagnosed
from truing.simulation.catalogue import catalogue
from truing.simulation.detection_trials import Answer, DetectionQuestion, Trial, questions
from truing.stages.diagnosis.search import assembled_data
from truing.stages.power import expected_sights

SMALLEST = ("--draws", "1", "--cases", "1")
RESULTS = Path("runs") / "power-agreement.jsonl"
FACTORS = (0.6, 0.85, 1.2)  # of the size that theory expects to be found four times out of five
# Which of a cause's sorts are hidden: what they concern, and their parameters.
SORTS = {
    ("actuator-gain", "the whole", "gain"),
    ("actuator-gain", "one leg", "gain"),
    ("actuator-backlash", "the whole", "backlash"),
    ("platform-deformation-linear", "the whole", "kappa"),
    ("platform-deformation-linear", "one leg", "kappa"),
    ("leg-drift", "one leg", "drift"),
    ("leg-thermal", "the whole", "alpha"),
    ("measurement-scale", "the whole", "scale"),
    ("target-moved", "one target", "dx dy dz"),
}
SMALL = Targets(base=5, platform=4, per_leg=0)
WARM = Surroundings(temperature_step_c=0.3)

Record = dict[str, Any]


@dataclass(frozen=True)
class Place:
    """A layout of the comparison."""

    name: str
    ground: Ground


def places(seed: int) -> list[Place]:
    """The layouts: few targets; targets on the legs and uneven noise."""
    few = Layout("few", targets=SMALL, noise=Noise(0.006), faults=DataFaults(0.0, 0.0), surroundings=WARM)
    uneven = Noise(axis_ratio=(1.0, 1.0, 3.0), write_sigmas=True)
    legs = replace(few, name="legs", targets=replace(SMALL, per_leg=3), noise=uneven)
    return [Place(layout.name, Ground(layout, 16, 3, seed)) for layout in (few, legs)]


def questions_of_layout(ground: Ground) -> list[DetectionQuestion]:
    """The questions of a layout, with what theory expects."""
    seen = expected_sights(ground.plan, assembled_data(ground.power_tables([], 0), ground.settings), ground.settings)
    found = questions(ground.plan, seen, CAUSES, catalogue().values())
    return [question for question in found if _sort_of(question) in SORTS and question.expected is not None]


def cases(listed: Sequence[Place], draws: int, done: set[str]) -> Iterator[Record]:
    """Both answers to every case that is not done; one of each before the second of any."""
    questions_of = {place.name: questions_of_layout(place.ground) for place in listed}
    for number in range(draws):
        for place in listed:
            for question, step in product(questions_of[place.name], range(len(FACTORS))):
                key = " ".join([place.name, *_sort_of(question), str(FACTORS[step]), str(number)])
                if key not in done:
                    yield {"key": key, "layout": place.name, **hidden_twice(place.ground, question, step, number)}


def hidden_twice(ground: Ground, question: DetectionQuestion, step: int, number: int) -> Record:
    """One effect, drawn and generated; the diagnosis of each, and the theoretical detection rate."""
    sort, size = question.kind, FACTORS[step] * (question.expected or 0.0)
    own = sorted(SORTS).index(_sort_of(question)), step, number
    effect = sort.draw(size, ground.plan.layout.model.part_count, np.random.default_rng([ground.seed, *own]))
    trial = Trial(0, FACTORS[step], (effect,), ())
    drawn, generated = ground.power_tables([effect], *own), ground.generated_tables([effect], *own)
    return {
        "cause": sort.kind,
        "concerns": sort.concerns,
        "parameter": question.unit.parameter,
        "unit": question.unit.unit,
        "factor": FACTORS[step],
        "size": size * question.unit.value,
        "subject": effect.cause.subject,
        "theory": question.rate(size),
        "power": _kept(diagnosed(drawn, ground.settings, trial)),
        "generator": _kept(diagnosed(generated, ground.settings, trial)),
    }


def _sort_of(question: DetectionQuestion) -> tuple[str, str, str]:
    return question.kind.kind, question.kind.concerns, question.unit.parameter


def _kept(answer: Answer) -> Record:
    return {key: value for key, value in asdict(answer).items() if key not in ("question", "factor")}


def _outcome(record: Record) -> str:
    return "named" if record["named"] else "found" if record["found"] else "-"


def kept(results: Path) -> list[Record]:
    """The results so far."""
    lines = results.read_text(encoding="utf-8").splitlines() if results.exists() else []
    return [json.loads(line) for line in lines]


def run_missing(listed: Sequence[Place], draws: int, results: Path, most: int | None = None) -> Iterator[Record]:
    """Runs what the results lack, at most so many, and adds it to them as it comes."""
    done = {record["key"] for record in kept(results)}
    results.parent.mkdir(parents=True, exist_ok=True)
    with results.open("a", encoding="utf-8") as file:
        for record in islice(cases(listed, draws, done), most):
            file.write(json.dumps(record) + "\n")
            file.flush()
            yield record


def main() -> None:
    """Run what is missing, and write the page if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=4, help="per size of every sort of effect")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, help="end after so many")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--write", action="store_true", help="make the page anew")
    options = parser.parse_args()
    for record in run_missing(places(options.seed), options.draws, options.results, options.cases):
        print(record["key"], *(f"{who} {_outcome(record[who])}" for who in ("power", "generator")), flush=True)
    if options.write:
        from benchmarks.power_agreement_page import write_page

        write_page(kept(options.results))


if __name__ == "__main__":
    main()
