"""Runs campaigns through the command line, reads what was found, and judges rates pooled, with binomial limits."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.blind.generator.folder import truth_path
from tests.blind.generator.quaternions import Array

PROJECT = Path(__file__).resolve().parents[2]
UNLUCKY = 1e-3  # a correct diagnosis fails a judgement at most once in a thousand draws


@dataclass(frozen=True)
class Finding:
    """A row of diagnosis.parquet: cause, verdict, subject, and the values and sigmas of its parameters by name."""

    cause: str
    verdict: str
    subject: str
    value: dict[str, float]
    sigma: dict[str, float]


@dataclass(frozen=True)
class Judged:
    """A campaign that was run: what the diagnosis said, and the effects that were hidden (as the truth tells them)."""

    name: str
    findings: tuple[Finding, ...]
    hidden: tuple[dict, ...]

    @property
    def found(self) -> tuple[Finding, ...]:
        return tuple(row for row in self.findings if row.verdict == "found")

    @property
    def missed(self) -> set[str]:
        """Causes that were hidden and not found."""
        return {effect["cause"] for effect in self.hidden} - {row.cause for row in self.found}

    @property
    def invented(self) -> list[str]:
        """What was found although nobody had hidden it."""
        causes = {effect["cause"] for effect in self.hidden}
        return [f"{row.cause} {row.subject}".strip() for row in self.found if row.cause not in causes]

    def pulls(self, cause: str) -> Array:
        """(value - truth) / sigma of every parameter of a cause that was hidden and found."""
        truth = next(effect for effect in self.hidden if effect["cause"] == cause)["parameters"]
        row = next(row for row in self.found if row.cause == cause)
        return np.array([(row.value[name] - truth[name]["value"]) / row.sigma[name] for name in truth])


def run_all(folders: Sequence[Path]) -> list[Judged]:
    """Runs every campaign folder through the command line, two at a time."""
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(run, folders))


def run(folder: Path) -> Judged:
    """``python -m pipeline run`` on one folder, as far as the diagnosis."""
    out, _ = through_the_command_line(folder, "diagnose")
    hidden = json.loads(truth_path(folder).read_text(encoding="utf-8"))["effects"]
    return Judged(folder.name, _findings(out / "diagnosis.parquet"), tuple(hidden))


def through_the_command_line(folder: Path, stage: str) -> tuple[Path, str]:
    """Runs one folder as far as a stage; where its artifacts are, and what it printed."""
    out = folder.with_name(f"{folder.name}.run")
    command = [sys.executable, "-m", "pipeline", "run", str(folder), "--out", str(out), "--only", stage]
    # Two runs side by side would otherwise each start a thread per core.
    one_thread = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=PROJECT, env=one_thread, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{folder.name} ended with {done.returncode}:\n{done.stdout}{done.stderr}"
    return out, done.stdout


def _findings(path: Path) -> tuple[Finding, ...]:
    import pyarrow.parquet as pq

    return tuple(_finding(row) for row in pq.read_table(path).to_pylist())


def _finding(row: dict[str, str]) -> Finding:
    parameters = json.loads(row["parameters"] or "{}")
    return Finding(
        cause=row["cause"],
        verdict=row["verdict"],
        subject=row["subject"] or "",
        value={name: entry["value"] for name, entry in parameters.items()},
        sigma={name: entry["sigma"] for name, entry in parameters.items()},
    )


def most_of(trials: int, probability: float) -> int:
    """The largest count that chance exceeds at most once in a thousand, at ``probability`` per trial."""
    from scipy.stats import binom

    return int(binom.isf(UNLUCKY, trials, probability))


def fewest_of(trials: int, probability: float) -> int:
    """The smallest count that chance falls below at most once in a thousand, at ``probability`` per trial."""
    return trials - most_of(trials, 1 - probability)
