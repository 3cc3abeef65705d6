"""Which results of a run may stand on a certificate, and why a run has none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from truing.estimation.uncertainty_budget import NOT_HELD
from truing.report.uncertainty.section import KINDS
from truing.runs.exports.certificate.units import si_unit

if TYPE_CHECKING:
    import pandas as pd

    from truing.runs.recorded_run import Run


@dataclass(frozen=True)
class Qualified:
    """Results that may be certified, as rows of ``uncertainty``; and sentences on what may not, and is in no budget."""

    results: pd.DataFrame
    left_out: tuple[str, ...]
    omitted: tuple[str, ...]


def failed_checks(run: Run) -> list[str]:
    """The failed checks of a run that no person has accepted."""
    if "qa" not in run:
        return []
    checks = run["qa"]
    failed = checks[checks["verdict"] == "fail"]
    if "accepted" in failed:
        failed = failed[failed["accepted"].isna()]
    return sorted({f"{row.check} {row.subject or ''}".strip() for row in failed.itertuples()})


def qualified(run: Run) -> Qualified:
    """The results with an uncertainty that holds; those of a fit without a cause that was found are none."""
    stated, parts = run["uncertainty"], run["uncertainty_budget"]
    good = stated[stated["stated"] & stated["estimate"].notna() & (stated["expanded_uncertainty"] > 0.0)]
    good = good[good["coverage_factor"] >= 1.0]  # others have no place in D-SI
    left_out = []
    for kind, off in _off(parts).items():
        if (good["result"] == kind).any():
            good = good[good["result"] != kind]
            left_out.append(f"{KINDS[kind]}: {', '.join(off)}: {NOT_HELD}.")
    strange = [unit for unit in dict.fromkeys(good["unit"].fillna("1")) if si_unit(unit) is None]
    if strange:
        good = good[~good["unit"].fillna("1").isin(strange)]
        left_out.append(f"Results in units that the SI has no name for: {', '.join(strange)}.")
    told = parts[(parts["evaluation"] == "not evaluated") & parts["result"].isin(good["result"])]
    omitted = [f"{row.result}: {row.input_source} ({row.reason})." for row in told.itertuples()]
    return Qualified(good, tuple(left_out), tuple(dict.fromkeys(omitted)))


def _off(parts: pd.DataFrame) -> dict[str, list[str]]:
    """By kind of result, the causes that its estimates are off by and its uncertainty does not cover."""
    rows = parts[parts["reason"] == NOT_HELD]
    return {str(kind): list(dict.fromkeys(own["input_source"])) for kind, own in rows.groupby("result", sort=False)}


def temperature(run: Run) -> tuple[float, float] | None:
    """The lowest and the highest temperature, degrees C, that the campaign has recorded; None where it has none."""
    for table, column in (
        *(("configurations", "temperature_c"), ("readings", "material_temperature_c")),
        *(("signals", "material_temperature_c"), ("positions", "material_temperature_c")),
        *(("readings", "air_temperature_c"), ("signals", "air_temperature_c"), ("positions", "air_temperature_c")),
    ):
        values = run[table][column].dropna() if table in run and column in run[table] else None
        if values is not None and len(values):
            return float(values.min()), float(values.max())
    return None
