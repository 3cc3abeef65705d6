"""Blind benchmark: rates of right and wrong diagnoses in hundreds of campaigns with random hidden effects.

    python -m benchmarks.blind [--instrument sensor] [--campaigns 40] [--workers 2] [--seed S] [--results F] [--write]
    python -m benchmarks.blind --instrument sensor --unforeseen [...]: effects thought of when the diagnosis stood
    python -m benchmarks.blind [--instrument sensor] --foreign [...]: worlds that nobody described
    python -m benchmarks.blind [--instrument sensor] --foreign-alone [...]: one effect of these worlds at a time
    python -m benchmarks.blind [--instrument sensor] --added [...]: causes that joined the catalogue since the page was
        drawn, one by one

Campaigns come from the generator of the blind tests, which shares no code with truing, and go through the command line.
Each is drawn from the seed and its own number, so that a run that was cut short goes on where it stopped; results are
kept line by line in F. ``--write`` makes the tables and figures of the instrument's page anew from it.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.blind_instruments import INSTRUMENTS, Instrument
from tests.blind.judging import Assessed, Record, run_share
from tests.blind.rates import clear_from, summary

RUNS = Path("runs")
# Of twenty campaigns: nothing, one effect, two, one of no catalogue.
CYCLE = ("nothing",) * 5 + ("one",) * 9 + ("two",) * 3 + ("unknown",) * 3
UNFORESEEN, FOREIGN, ALONE, ADDED = "unforeseen", "foreign", "foreign-alone", "added"
FOREIGN_SNR = 10.0, 40.0  # of each effect of a foreign world
BELOW_CLEAR = 0.3  # of single effects: too weak to be found for certain
OBVIOUS = (3.0, 30.0)  # times clear, where an instrument's share of them is drawn
PER_CALL = 4
SMALLEST = ("--campaigns", "1", "--workers", "1")


@dataclass(frozen=True)
class Drawn:
    """One campaign of the benchmark: what is hidden in it, in which layout, how strong."""

    number: int
    group: str
    names: tuple[str, ...]
    layout: str
    strength: float
    seed: int
    instrument: str


def drawn(number: int, seed: int, instrument: str = "photogrammetry", group: str | None = None) -> Drawn:
    """The campaign of a number: groups (or the one given) and causes take turns, all else is drawn."""
    own = INSTRUMENTS[instrument]
    rng = np.random.default_rng([seed, 6, number])
    place = number * 7 % len(CYCLE)  # 7 and 20 have no divisor in common: groups are mixed
    group = group or CYCLE[place]
    names = _names(group, own, rng, number)
    kinds = own.layouts_for(names)
    strength = _strength(group, names, own.obvious, rng)
    return Drawn(number, group, names, str(rng.choice(kinds)), strength, int(rng.integers(2**31)), instrument)


def _names(group: str, instrument: Instrument, rng: np.random.Generator, number: int) -> tuple[str, ...]:
    if group == "one":
        return (str(rng.choice(sorted(set(instrument.catalogue) - set(instrument.added)))),)
    if group == ADDED:
        return (sorted(instrument.added)[number % len(instrument.added)],)
    if group == "two":
        return instrument.draw_two(rng)
    if group == "unknown":
        return (str(rng.choice(sorted(instrument.uncatalogued))),)
    if group == UNFORESEEN:
        return (str(rng.choice(sorted(instrument.unforeseen))),)
    if group == ALONE:
        return (sorted(instrument.foreign)[number % len(instrument.foreign)],)
    if group == FOREIGN:
        return tuple(rng.choice(sorted(instrument.foreign), int(rng.integers(2, 5)), replace=False).tolist())
    return ()


def _strength(group: str, names: Sequence[str], obvious: float, rng: np.random.Generator) -> float:
    """From where the effects must be found up to three times that; of single ones some are weaker, some obvious."""
    if not names:
        return 1.0
    if group in (FOREIGN, ALONE):
        return float(np.exp(rng.uniform(*np.log(FOREIGN_SNR))))
    clear = max(clear_from(name, two=group == "two") for name in names)
    if group in ("one", ADDED) and rng.random() < BELOW_CLEAR:
        return float(clear * rng.uniform(0.4, 1.0))
    if obvious and len(names) == 1 and rng.random() < obvious:
        return float(clear * np.exp(rng.uniform(*np.log(OBVIOUS))))
    return float(clear * np.exp(rng.uniform(0.0, np.log(3.0))))


def run(cases: Sequence[Drawn]) -> list[Record]:
    """Draws, writes and diagnoses campaigns in one call of the command line."""
    hidden, records = [], []
    with tempfile.TemporaryDirectory() as home:
        folders = []
        for one in cases:
            own = {"number": one.number, "group": one.group}
            try:
                case = INSTRUMENTS[one.instrument].hide(one.names, one.layout, one.strength, one.seed)
            except ValueError as why:  # what a layout does not show cannot be hidden in it
                records.append(own | {"name": f"{one.group}-{one.number}", "failed": str(why)})
                continue
            folders.append(case.write(Path(home) / f"{one.group}-{one.number}"))
            hidden.append(own)
        records += [own | record for own, record in zip(hidden, run_share(folders), strict=True)]
    return records


def kept(results: Path) -> list[Record]:
    """The results so far, without those of campaigns that failed: they are run again."""
    lines = results.read_text(encoding="utf-8").splitlines() if results.exists() else []
    return [record for record in map(json.loads, lines) if "failed" not in record]


def run_missing(cases: Sequence[Drawn], results: Path, workers: int) -> Iterator[Record]:
    """Runs what the results lack, and adds it to them as it comes."""
    done = {record["number"] for record in kept(results)}
    missing = [case for case in cases if case.number not in done]
    shares = [missing[start : start + PER_CALL] for start in range(0, len(missing), PER_CALL)]
    results.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(workers) as pool, results.open("a", encoding="utf-8") as file:
        for future in as_completed([pool.submit(run, share) for share in shares]):
            for record in future.result():
                file.write(json.dumps(record) + "\n")
                file.flush()
                yield record


def main() -> None:
    """Run what is missing, and write the page if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--instrument", choices=sorted(INSTRUMENTS), default="photogrammetry")
    parser.add_argument("--campaigns", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="number of the first one: those before may have been seen")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, help="default: that of the instrument's page")
    parser.add_argument("--results", type=Path, help="default: runs/<name of the instrument's results>.jsonl")
    groups = parser.add_mutually_exclusive_group()
    for option, group, what in (
        ("--unforeseen", UNFORESEEN, "effects thought of later"),
        ("--foreign", FOREIGN, "worlds that nobody described"),
        ("--foreign-alone", ALONE, "one effect of these worlds at a time; the pages hold no table of it"),
        ("--added", ADDED, "causes that joined the catalogue since"),
    ):
        groups.add_argument(option, dest="group", action="store_const", const=group, help=what)
    parser.add_argument("--write", action="store_true", help="make the page anew")
    options = parser.parse_args()
    if options.write and options.group == ALONE:
        parser.error("--write: the pages hold no table of --foreign-alone")
    own = INSTRUMENTS[options.instrument]
    results = options.results or RUNS / f"{own.short_name}{f'-{options.group}' if options.group else ''}.jsonl"
    numbers = range(options.first, options.first + options.campaigns)
    seed = own.seed if options.seed is None else options.seed
    cases = [drawn(number, seed, options.instrument, options.group) for number in numbers]
    for record in run_missing(cases, results, options.workers):
        print(_line(record), flush=True)
    from benchmarks import blind_page

    campaigns = [Assessed(record) for record in kept(results)]
    tables = {
        None: lambda: blind_page.goals(campaigns, own),
        UNFORESEEN: lambda: blind_page.unknown(campaigns),
        ADDED: lambda: blind_page.causes(campaigns, own),
    }
    print(tables.get(options.group, lambda: blind_page.foreign(campaigns))())
    if options.write:
        write = {
            None: blind_page.write_page,
            UNFORESEEN: blind_page.write_unforeseen,
            ADDED: blind_page.write_added,
        }.get(options.group, blind_page.write_foreign)
        write(kept(results), own)


def _line(record: Record) -> str:
    if "failed" in record:
        return f"{record['name']} FAILED\n{record['failed']}"
    return f"{record['seconds']:5.1f} s  {summary(Assessed(record))}"


if __name__ == "__main__":
    main()
