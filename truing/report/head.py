"""The top of the page: what a busy person acts on, and the figures that place it."""

from __future__ import annotations

import math

from truing.report.calibration.calibrations import EXTENDED, TO_POINTS, figures_by_calibration, main_calibration
from truing.report.calibration.requirements import chosen_requirements, tally
from truing.report.calibration.with_findings import choice_verdicts
from truing.report.diagnosis.pulls import change_words, has_changed
from truing.report.diagnosis.words import diagnosis_verdicts, lower
from truing.report.numbers import count, handy, plain, printed, quantity
from truing.report.page import Head, Verdict
from truing.report.quality_section import accepted_verdicts
from truing.report.reasons import why_absent, why_no_quality, why_no_requirement
from truing.report.sensor.positioning import not_stated
from truing.report.tables import Tables, filled, in_channel_order, is_bench, load_steps, signal_names
from truing.schemas.quality_checks import WITHHOLDING

_MODEL_WORDS = {"none": "rms shift, no model", "linear": "rms left, linear model", "matrix": "rms left, matrix model"}
_BENCH_WORDS = {"none": "rms response", "linear": "left by its own axis", "matrix": "left by a full compliance"}
_OF_AXES = {"A": "accuracy A", "B": "reversal B"}  # as ISO 230-2 has them
_OF_POSITIONING = {"A": "accuracy A", "R": "repeatability R", "B": "reversal B"}
_FEW_AXES = 3
_HELD_OUT = {"position": "um", "orientation": "arcsec"}


def build_head(campaign: str, tables: Tables) -> Head:
    """The sentences that a busy person acts on, and the figures that place them."""
    withheld = _withheld(tables)
    told = [
        *withheld,
        *_positioning(tables),
        *diagnosis_verdicts(tables),
        *_changes(tables),
        *choice_verdicts(tables),
        *_requirements(tables),
        *_quality(tables, len(withheld)),
    ]
    verdicts = sorted(told, key=lambda verdict: verdict[0] == "none")
    return Head(campaign, tuple(verdicts), tuple(_tiles(tables)))


def _positioning(tables: Tables) -> list[Verdict]:
    """What a campaign of positioning alone is measured for: accuracy, repeatability and reversal of its worst axis."""
    rows = filled(tables, "positioning")
    if rows is None or len(load_steps(tables)) or filled(tables, "observations") is not None:
        return []
    axis = rows[rows["subject"].isna() & rows["figure"].isin(list(_OF_POSITIONING))]
    worst = axis[axis["figure"].eq("A")].nlargest(1, "value")["run"]
    own = axis[axis["run"].isin(worst)].set_index("figure")
    if not len(own):
        return []
    sigma = own["sigma"] if "sigma" in own else own["value"] * math.nan
    told = [
        f"{words} {handy(float(own.loc[name, 'value']), float(sigma[name]), str(own.loc[name, 'unit']))}"
        for name, words in _OF_POSITIONING.items()
        if name in own.index
    ]
    several = rows["run"].nunique()
    withheld = len(not_stated(tables))
    also = f" Of {count(withheld, 'further run')} nothing is stated, see Positioning." if withheld else ""
    which = f"the worst of {several} runs, {worst.iloc[0]}" if several > 1 else str(worst.iloc[0])
    return [("measured", printed(f"By ISO 230-2, {which}: {', '.join(told)}, each with one standard deviation.{also}"))]


def _changes(tables: Tables) -> list[Verdict]:
    said = change_words(tables)
    return [("warn" if has_changed(tables) else "pass", said)] if said else []


def _withheld(tables: Tables) -> list[Verdict]:
    """The failed checks by which the data do not belong together: which, what it found, what to do, what waits."""
    qa = filled(tables, "qa")
    if qa is None:
        return []
    failed = qa[qa["verdict"].eq("fail") & qa["check"].isin(list(WITHHOLDING)) & ~accepted_verdicts(qa)]
    told = []
    for name, own in failed.groupby("check", sort=False):
        check = WITHHOLDING[str(name)]
        more = f" ({len(own) - 1} more under Quality.)" if len(own) > 1 else ""
        first = f"Quality check {name} failed: {printed(own['message'].iloc[0])}{more}"
        do = printed(check.to_do.replace("`", ""))
        told.append(("fail", f"{first} {do} Until then {check.stages_withheld} are not evaluated."))
    return told


def _quality(tables: Tables, told: int) -> list[Verdict]:
    """All checks in a line; ``told``: how many failed ones stand above it already."""
    if "qa" not in tables:
        return []
    qa = tables["qa"]
    if not len(qa):
        return [("none", f"Quality not evaluated: {lower(why_no_quality(tables))}")]
    accepted = accepted_verdicts(qa)
    said = f" {count(int(accepted.sum()), 'verdict')} accepted by a person, see Quality." if accepted.any() else ""
    failed, warned = (qa[(qa["verdict"] == v) & ~accepted] for v in ("fail", "warn"))
    if len(failed):
        if told:
            return [("fail", f"{len(failed)} of {len(qa)} quality checks failed, see Quality.{said}")]
        rest = f" {len(failed) - 1} more under Quality." if len(failed) > 1 else ""
        return [
            (
                "fail",
                f"{len(failed)} of {len(qa)} quality checks failed. {printed(failed['message'].iloc[0])}{rest}{said}",
            )
        ]
    if len(warned):
        first = printed(warned["message"].iloc[0])
        return [("warn", f"No quality check failed; {len(warned)} of {len(qa)} call for a look. First: {first}{said}")]
    return [("pass", f"None of the {len(qa)} quality checks failed or calls for a look.{said}")]


def _requirements(tables: Tables) -> list[Verdict]:
    own = chosen_requirements(tables)
    if own is None:
        return _no_requirements(tables)
    failed = own[own["verdict"] == "fails"]
    if len(failed):
        worst = failed.assign(ratio=failed["error"] / failed["requirement"]).nlargest(1, "ratio").iloc[0]
        return [("fail", f"{tally(own)}. Worst: {worst['component']}, {plain(worst['ratio'])} times what is required.")]
    return [("warn" if (own["verdict"] == "undecided").any() else "pass", f"{tally(own)}, by the calibrated model.")]


def _no_requirements(tables: Tables) -> list[Verdict]:
    why = why_no_requirement(tables) if "requirements" in tables else why_absent("requirements", tables)
    return [("none", f"Requirements not evaluated: {lower(why)}")]


def _tiles(tables: Tables) -> list[tuple[str, str]]:
    tiles = []
    points, residuals = (filled(tables, name) for name in ("observations", "residuals"))
    if points is not None:
        tiles += [("poses", f"{points['pose'].nunique():,}"), ("object points", f"{len(points):,}")]
    tiles += _bench_tiles(tables)
    if residuals is not None:
        out = int(residuals["rejected"].sum())
        tiles.append(("points left out", f"{out:,} ({100 * out / len(residuals):.1f} %)"))
    return tiles + _model_tiles(tables) + _positioning_tiles(tables) + _calibration_tiles(tables)


def _bench_tiles(tables: Tables) -> list[tuple[str, str]]:
    """Runs, load steps, readings and signals."""
    steps, readings, signals = load_steps(tables), filled(tables, "readings"), signal_names(tables)
    if not len(steps):
        return []
    tiles = [("runs", f"{steps['run'].nunique():,}"), ("load steps", f"{len(steps):,}")]
    if readings is not None:
        channels = in_channel_order(readings["channel"].unique())
        tiles += [("readings", f"{len(readings):,}"), ("channels", " ".join(channels))]
    return [*tiles, ("signals", str(len(signals)))] if signals else tiles


def _model_tiles(tables: Tables) -> list[tuple[str, str]]:
    """How far things moved, and what each model leaves of it; of a bench before any model and after the best."""
    errors = filled(tables, "deformation_errors")
    if errors is None:
        return []
    subject = errors["subject"] if "subject" in errors else errors["leg"]
    whole = errors[errors["figure"].eq("rms_error") & errors["leg"].isna() & subject.isna()]
    bench = is_bench(tables)
    if bench and len(whole):
        whole = whole[whole["model"].isin([whole["model"].iloc[0], whole["model"].iloc[-1]])]
    named = _BENCH_WORDS if bench else _MODEL_WORDS
    by_model = whole.groupby("model", sort=False)
    return [(named.get(str(m), str(m)), ", ".join(map(quantity, own["value"], own["unit"]))) for m, own in by_model]


def _positioning_tiles(tables: Tables) -> list[tuple[str, str]]:
    """Accuracy and reversal of the axes that were positioned, the first few of them."""
    rows = filled(tables, "positioning")
    if rows is None:
        return []
    own = rows[rows["subject"].isna() & rows["figure"].isin(list(_OF_AXES))]
    own = own[own["run"].isin(own["run"].unique()[:_FEW_AXES])]
    shown = zip(own["run"], own["figure"], own["value"], own["unit"], strict=True)
    return [(f"{_OF_AXES[figure]}, {run}", quantity(value, unit)) for run, figure, value, unit in shown]


def _calibration_tiles(tables: Tables) -> list[tuple[str, str]]:
    """How far the chosen model misses on average where nothing was fitted to."""
    chosen = main_calibration(tables)
    by = {"estimator": TO_POINTS} if chosen is not None and chosen[0] == EXTENDED else {}
    figures = figures_by_calibration(tables, **by)
    if figures is None or chosen is None:
        return []
    facts = figures.loc[chosen]
    sizes = [(facts.get(f"{what}_mean_verification"), unit) for what, unit in _HELD_OUT.items()]
    said = [quantity(size, unit) for size, unit in sizes if size is not None and size == size]
    return [("held-out error, calibrated", ", ".join(said))] if said else []
