"""Run campaigns through the command line, and compare the findings with the hidden effects."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tests.blind.at_once import AT_ONCE
from tests.blind.generator.folder import truth_path
from tests.blind.generator.quaternions import Array
from tests.loops import PACKAGE

PROJECT = Path(__file__).resolve().parents[2]
UNLUCKY = 1e-3  # a correct diagnosis fails a judgement at most once in a thousand draws
WITHIN_95 = 1.959964
REPORTED = ("found", "indistinguishable")
SUSPECTED = "suspected"  # no claim: it counts neither for nor against a name
# Suspected only because others may explain the same: reported as indistinguishable from them.
ALTERNATIVE = "alternative"
KEPT = ("cause", "verdict", "reason_code", "subject", "parameters", "follows", "p_value", "probability")
KEPT_OF_TRUTH = ("seed", "effects", "layout", "strengths", "driver_strengths")
KEPT_NUMBERS = ("rms_before", "rms_after", "heldout_rms_before", "heldout_rms_after", "noise_floor", "log_evidence")

_SAME_FLOOR = 0.2  # of a logarithm
Record = dict[str, Any]


@dataclass(frozen=True)
class Finding:
    """A reported row of diagnosis.parquet, with the values and sigmas of its parameters by name."""

    cause: str
    verdict: str
    subject: frozenset[str]
    follows: frozenset[str]
    value: dict[str, Any]
    sigma: dict[str, float | None]
    figures: dict[str, float | None]


@dataclass(frozen=True)
class Hidden:
    """An effect that was hidden: its cause, what it concerns and follows, its parameters, and how strong it is.

    ``of_drivers``: how strong the part is that only one of the columns tells which it follows, where that was measured.
    """

    cause: str
    kind: str
    subject: frozenset[str]
    follows: frozenset[str]
    value: dict[str, Any]
    strength: float
    of_drivers: Mapping[str, float]

    def clear_drivers(self, least: float) -> frozenset[str]:
        """The columns that it follows and whose own part is as strong as that."""
        return frozenset(column for column in self.follows if self.of_drivers.get(column, self.strength) >= least)


@dataclass(frozen=True)
class Assessed:
    """A campaign that was run: the findings of the diagnosis, and the hidden effects by the truth file."""

    record: Record

    @property
    def name(self) -> str:
        return str(self.record["name"])

    @cached_property
    def reported(self) -> tuple[Finding, ...]:
        return tuple(_finding(row, self._legs) for row in self.record["findings"] if _verdict(row) in REPORTED)

    @cached_property
    def suspected(self) -> tuple[Finding, ...]:
        return tuple(_finding(row, self._legs) for row in self.record["findings"] if _verdict(row) == SUSPECTED)

    @cached_property
    def hidden(self) -> tuple[Hidden, ...]:
        truth = self.record["truth"]
        strengths = truth.get("strengths") or [float("inf")] * len(truth["effects"])
        of_drivers = truth.get("driver_strengths") or [{}] * len(strengths)
        each = zip(truth["effects"], strengths, of_drivers, strict=True)
        return tuple(_hidden(effect, strength, own, self._legs) for effect, strength, own in each)

    @property
    def _legs(self) -> int:
        return int(self.record["truth"]["legs"])

    @property
    def found(self) -> tuple[Finding, ...]:
        return tuple(row for row in self.reported if row.verdict == "found")

    @property
    def detected(self) -> bool:
        """Return True if a cause is found, or an effect whose name is open among several."""
        return bool(self.found) or any(_is_open(row) for row in self.record["findings"])

    @property
    def missed(self) -> set[str]:
        """Causes that were hidden and not named, nor called indistinguishable from what was."""
        return {effect.cause for effect in self.hidden} - {row.cause for row in self.reported}

    @property
    def invented(self) -> list[str]:
        """Causes found that are neither hidden nor indistinguishable from a hidden one."""
        hidden = {effect.cause for effect in self.hidden}
        if self.missed:  # a wrong name in place of the right one is a matter of naming
            return []
        alike = {row.cause for row in self.reported if row.verdict == "indistinguishable"}
        spare = hidden & alike  # each hidden one that is only called alike stands behind one other name
        names = [row for row in self.found if row.cause not in hidden]
        return [f"{row.cause} {' '.join(sorted(row.subject))}".strip() for row in names[len(spare) :]]

    def misplaced(self, effect: Hidden) -> bool:
        """Return True if the rows of the hidden cause name other legs or targets."""
        rows = [row for row in self.reported if row.cause == effect.cause]
        best = [row for row in rows if row.verdict == "found"] or rows
        return frozenset[str]().union(*(row.subject for row in best)) != effect.subject

    def follows_right(self, effect: Hidden, least: float = 0.0) -> bool:
        """Return True if the rows of unexplained effects name all inputs whose part is at least that strong."""
        rows = [row for row in self.found if row.cause == "unexplained"]
        named = frozenset[str]().union(*(row.follows for row in rows))
        if not effect.follows:
            return any(row.subject == effect.subject for row in rows)
        return effect.clear_drivers(least) <= named

    @property
    def idle_columns(self) -> frozenset[str]:
        """Columns that something unexplained is reported to follow though no effect does.

        Time is none where something that nobody recorded walks in it, nor are readings where an instrument errs by
        where a point is, which follows them.
        """
        rows = [row for row in self.found if row.cause == "unexplained"]
        kinds = {effect.kind for effect in self.hidden}
        reported = frozenset[str]().union(*(row.follows for row in rows))
        reported -= frozenset[str]().union(*(effect.follows for effect in self.hidden))
        excused = {"time_s"} if "NobodyRecorded" in kinds else set()
        if "ForeignPoints" in kinds:
            excused |= {column for column in reported if column.startswith("rho")}
        return reported - excused

    @property
    def misnamed(self) -> list[str]:
        """Names of the catalogue that an effect of no catalogue was given."""
        return [row.cause for row in self.found if row.cause != "unexplained"]

    @property
    def unpaid(self) -> list[str]:
        """Causes found that raise the errors: fitted ones by more than 0.1 %, or held-out ones by more than 2.5 %."""
        rows = [(row.cause, row.figures) for row in self.found if "noise_ratio" not in row.value]
        fitted = {cause for cause, own in rows if _grows(own, "", 1e-3)}
        return sorted(fitted | {cause for cause, own in rows if _grows(own, "heldout_", 0.025)})

    def pulls(self, effect: Hidden) -> Array:
        """(value - truth) / sigma of every parameter of an effect that was found at the right place."""
        rows = [row for row in self.found if row.cause == effect.cause]
        return np.array([z for row in rows for z in _pulls(row, effect.value)])

    @property
    def floor_ratio(self) -> float | None:
        """Held-out error with all that was found over what noise leaves of it."""
        rows = [row.figures for row in self.found if row.figures["heldout_rms_after"]]
        if not rows or not rows[-1]["noise_floor"]:
            return None
        return rows[-1]["heldout_rms_after"] / rows[-1]["noise_floor"]

    @property
    def excess(self) -> tuple[float, float] | None:
        """Held-out squares beyond the floor's, over the floor's, without and with all that was found."""
        wanted = ("heldout_rms_before", "heldout_rms_after", "noise_floor")
        rows = [row.figures for row in self.found if all(row.figures[name] for name in wanted)]
        if not rows:
            return None
        floor = rows[-1]["noise_floor"]
        # A row tells of the readings that its cause concerns: of others, in another unit, the floor is another.
        same = [row for row in rows if abs(np.log(row["noise_floor"] / floor)) < _SAME_FLOOR]
        before, after = (row[name] / floor for row, name in ((same[0], wanted[0]), (same[-1], wanted[1])))
        return before**2 - 1, after**2 - 1


def _verdict(row: Record) -> str:
    return "indistinguishable" if _is_open(row) else str(row["verdict"])


def _is_open(row: Record) -> bool:
    return row["verdict"] == SUSPECTED and row.get("reason_code") == ALTERNATIVE


def _finding(row: Record, legs: int) -> Finding:
    parameters = json.loads(row["parameters"] or "{}")
    return Finding(
        cause=row["cause"],
        verdict=_verdict(row),
        subject=_words(row["subject"], legs),
        follows=frozenset((row["follows"] or "").split()),
        value={name: entry["value"] for name, entry in parameters.items()},
        sigma={name: entry["sigma"] for name, entry in parameters.items()},
        figures={name: row[name] for name in KEPT_NUMBERS},
    )


def _grows(figures: Mapping[str, float | None], held: str, share: float) -> bool:
    before, after = figures[f"{held}rms_before"], figures[f"{held}rms_after"]
    return before is not None and after is not None and after > (1.0 + share) * before


def _hidden(effect: Record, strength: float, of_drivers: Mapping[str, float], legs: int) -> Hidden:
    return Hidden(
        cause=effect["cause"],
        kind=effect.get("kind", effect["cause"]),
        subject=_words(effect["subject"], legs),
        follows=frozenset(effect.get("follows", "").split()),
        value={name: entry["value"] for name, entry in effect["parameters"].items()},
        strength=float(strength),
        of_drivers=of_drivers,
    )


def _words(subject: str | None, legs: int) -> frozenset[str]:
    """A subject as the set of its words; all legs are the whole, which has none."""
    words = frozenset((subject or "").replace("targets", "target").split())
    return frozenset() if words == {f"leg{leg}" for leg in range(1, legs + 1)} else words


def _pulls(row: Finding, truth: dict[str, Any]) -> list[float]:
    value = dict(row.value)
    for name in [name for name in value if name.startswith("amplitude")]:
        phase = name.replace("amplitude", "phase")
        if value[name] < 0 and phase in value:  # the same sine, half a turn further
            value[name], value[phase] = -value[name], value[phase] + np.pi
    if "alpha" in truth and "alpha_base" in value:  # named separately although they are the same
        truth = dict.fromkeys(value, truth["alpha"])
    pulls = []
    for name in truth.keys() & value.keys():
        if row.sigma[name]:
            off = value[name] - truth[name]
            off = (off + np.pi) % (2 * np.pi) - np.pi if name.startswith("phase") else off
            pulls.append(off / row.sigma[name])
    return pulls


def run_all(folders: Sequence[Path], workers: int = AT_ONCE) -> list[Assessed]:
    """Runs campaign folders through the command line, as many calls at a time, each with a share of them.

    A single call is made in this process: another would only load all libraries again.
    """
    if workers == 1:
        done = run_share(folders, _call_here)
    else:
        shares = [list(folders[start::workers]) for start in range(workers)]
        with ThreadPoolExecutor(workers) as pool:
            done = [record for records in pool.map(run_share, shares) for record in records]
    broken = {record["name"]: record["failed"] for record in done if "failed" in record}
    assert not broken, broken
    return [Assessed(record) for record in done]


def run_share(folders: Sequence[Path], call: Callable[[list[str]], tuple[int, str]] | None = None) -> list[Record]:
    """Runs folders of campaigns with names of their own in one call, as far as the diagnosis; one that leaves none has
    ``failed`` in its record, which is what the call printed. ``call`` is by default another process.
    """
    if not folders:
        return []
    out = folders[0].with_name(f"{folders[0].name}.runs")
    words = ["run", *map(str, folders), "--out", str(out), "--only", "diagnose", "--qa", "warn"]
    start = _processor_seconds()
    code, printed = (call or _call_another)(words)
    seconds = (_processor_seconds() - start) / len(folders)
    places = [out / folder.name if len(folders) > 1 else out for folder in folders]
    said = f"exit code {code}\n{printed}"
    return [_read(folder, place, seconds, said) for folder, place in zip(folders, places, strict=True)]


COMMAND = [sys.executable, "-m", "pipeline"]


def _call_another(words: list[str]) -> tuple[int, str]:
    done = subprocess.run(
        [*COMMAND, *words], cwd=PROJECT, env=_one_thread(), capture_output=True, text=True, check=False
    )
    return done.returncode, done.stderr or done.stdout


def _call_here(words: list[str]) -> tuple[int, str]:
    from typer.testing import CliRunner

    from truing.pipeline.command_line import app

    with warnings.catch_warnings():
        warnings.resetwarnings()  # as in a process of its own, where they end nothing
        done = CliRunner().invoke(app, words)
    return done.exit_code, done.output


def _processor_seconds() -> float:
    """Processor time of this process and its calls so far, s; unlike wall time, it does not depend on other load."""
    return sum(os.times()[:4])


def _one_thread() -> dict[str, str]:
    # Two runs side by side would otherwise each start a thread per core. A delta robot needs its own closure.
    return {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": PACKAGE}


def _read(folder: Path, out: Path, seconds: float, said: str) -> Record:
    """Plain values of one run that are assessed."""
    import pyarrow.parquet as pq

    truth = json.loads(truth_path(folder).read_text(encoding="utf-8"))
    kept = {key: truth[key] for key in KEPT_OF_TRUTH if key in truth}
    record: Record = {
        "name": folder.name,
        "truth": {**kept, "legs": truth["legs"] if "legs" in truth else len(truth["geometry"]["a_mm"])},
        "seconds": round(seconds, 2),
    }
    if not (out / "diagnosis.parquet").exists():
        log = out / "defect.log"
        return record | {"failed": log.read_text(encoding="utf-8")[-1500:] if log.exists() else said}
    rows = pq.read_table(out / "diagnosis.parquet").to_pylist()
    others = [
        row for row in rows if row["verdict"] not in (*REPORTED, SUSPECTED) and row.get("log_evidence") is not None
    ]
    others.sort(key=lambda row: -row["log_evidence"])
    sums = out / "pull_sums.parquet"
    return record | {
        "findings": [
            {key: row.get(key) for key in (*KEPT, *KEPT_NUMBERS)}
            for row in rows
            if row["verdict"] in (*REPORTED, SUSPECTED)
        ],
        "rejected": [[row["cause"], row["subject"], row["log_evidence"]] for row in others[:3]],
        "pull_sums": pq.read_table(sums).to_pylist() if sums.exists() else [],
    }


def most_of(trials: int, probability: float) -> int:
    """The largest count that chance exceeds at most once in a thousand, at ``probability`` per trial."""
    from scipy.stats import binom

    return int(binom.isf(UNLUCKY, trials, probability))


def fewest_of(trials: int, probability: float) -> int:
    """The smallest count that chance falls below at most once in a thousand, at ``probability`` per trial."""
    return trials - most_of(trials, 1 - probability)
