"""Checks of the scale of photographs: its sources, contradictions, scale bars and reference lengths."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.arrays import Array
from truing.estimation.bundle.length_errors import CalibratedLengths, LengthErrors, length_errors
from truing.report.numbers import count_text, listed
from truing.schemas.photograph_artifacts import FROM_MARKER, FROM_SURVEY, LENGTH, LENGTH_SIGMA
from truing.stages.common.point_arrays import number_column, text_column
from truing.stages.quality.check import FAIL, NOT_EVALUATED, PASS, WARN, CampaignLimits, Check, not_evaluated

Figures = defaultdict[str, dict[str, float]]

_FIGURE = ("figure", "subject", "value")
_BEYOND = 5.0  # sigmas
# Relative difference of lengths: thermal growth is smaller, and smaller differences are reported bar by bar.
_MATTERS = 5e-4
_NOISY = 2.0  # noise of image coordinates over what is stated, from which on lengths may err by the rays
_LEAST = 1e-9
_SURVEY = "survey of "
# Checks that a wrong scale trips: nothing follows from them before it is mended.
_CONSEQUENCES = frozenset(
    (
        *("poses-determined", "gross-errors", "noise", "residuals-systematic", "image-noise", "bar-lengths"),
        *("camera-stability", "target-sizes", "length-errors", "points-against-survey"),
    )
)
_SIZES = "size over stated"
_NO_BAR = (FROM_SURVEY, FROM_MARKER)


def figures_of(statistics: pa.Table) -> Figures:
    """The rows of bundle_statistics by figure and subject; nothing of figures that it does not have."""
    figures: Figures = defaultdict(dict)
    for figure, subject, value in zip(*(statistics.column(name).to_pylist() for name in _FIGURE), strict=True):
        figures[figure][subject] = value
    return figures


def rows_of(table: pa.Table, column: str, value: object) -> pa.Table:
    """The rows in which a column has a value."""
    return table.filter(pc.equal(table.column(column), value))


@dataclass(frozen=True)
class Contradiction:
    """A length, or several, that contradict the others: names, relative difference, its sigma.

    ``noise``: noise of image coordinates over what is stated, of the noisiest kind of target.
    """

    odd: tuple[str, ...]
    others: tuple[str, ...]
    by: float
    sigma: float
    noise: float = 1.0

    @property
    def sentence(self) -> str:
        """The sentence of the check ``scale``."""
        size = f"{1e3 * abs(self.by):.3g} ± {1e3 * self.sigma:.1g} mm/m {'larger' if self.by > 0 else 'smaller'}"
        odd, others = listed(self.odd), listed(self.others)
        if len(self.others) == 1:
            text = f"{odd} and {others} contradict each other about the scale: lengths by {odd} are {size}."
            return f"{text} One of them is wrong; a third length would show which.{self._rays}"
        text = f"{odd} contradicts {others} about the scale: lengths by {odd} are {size}, and the others agree."
        return f"{text} Check its length, its ends and its unit.{self._rays}"

    @property
    def _rays(self) -> str:
        if self.noise < _NOISY:
            return ""
        return (
            f" But the noise of image coordinates is {self.noise:.1f} times what is stated: where the distortion of a "
            "camera is incomplete (free of [[cameras]]) or rays are wrong, lengths err, too."
        )


def scale_contradiction(figures: Figures) -> Contradiction | None:
    """Return the source of scale that contradicts the others; None if all agree within their uncertainty."""
    names, x, s = _statements(figures)
    if len(names) < 2:
        return None
    odd = np.zeros(len(names), bool)
    odd[0 if len(names) == 2 else int(np.argmin([_chi2(np.delete(x, k), np.delete(s, k)) for k in range(len(x))]))] = (
        True
    )
    mean = [float(np.average(x[part], weights=s[part] ** -2)) for part in (odd, ~odd)]
    sigma = float(np.sqrt(sum(1.0 / np.sum(s[part] ** -2) for part in (odd, ~odd))))
    by = mean[0] / mean[1] - 1.0
    sides = [tuple(name for name, is_odd in zip(names, part, strict=True) if is_odd) for part in (odd, ~odd)]
    if abs(by) <= max(_MATTERS, _BEYOND * sigma):
        return None
    return Contradiction(sides[0], sides[1], by, sigma, max(figures["noise over stated"].values(), default=1.0))


def _statements(figures: Figures) -> tuple[list[str], Array, Array]:
    """Names, ratios and sigmas of the sources of lengths; bodies of one survey that agree are one statement."""
    ratio, spread = figures[LENGTH], figures[LENGTH_SIGMA]
    bodies = [name for name in ratio if name.startswith(_SURVEY)]
    others = [name for name in ratio if name not in bodies]
    x, s = (np.array([reported[name] for name in bodies]) for reported in (ratio, spread))
    names, values, sigmas = others, [ratio[name] for name in others], [spread[name] for name in others]
    if len(bodies) > 1 and np.ptp(x) <= max(_MATTERS, _BEYOND * float(s.max())):
        names, values, sigmas = [*others, "the survey"], [*values, float(np.mean(x))], [*sigmas, float(s.max())]
    else:
        names, values, sigmas = [*others, *bodies], [*values, *x], [*sigmas, *s]
    return names, np.array(values), np.maximum(np.array(sigmas), _LEAST)


def _chi2(x: Array, s: Array) -> float:
    return float(np.sum((x - np.average(x, weights=s**-2)) ** 2 / s**2))


def without_consequences(checks: Iterable[Check]) -> Iterator[Check]:
    """Checks of a network with contradictory scale, without the verdicts of checks that only this triggers."""
    for check in checks:
        if check.check in _CONSEQUENCES and check.verdict in (FAIL, WARN):
            text = "Not evaluated: lengths contradict each other about the scale (see the check scale)."
            yield replace(check, value=None, limit=None, unit="", verdict=NOT_EVALUATED, message=text)
        else:
            yield check


def scale(figures: Figures, lengths: pa.Table | None, *, surveyed: bool) -> Iterator[Check]:
    """Check that each pose has a scale; report its source and its checks.

    ``surveyed``: the shape of bodies is known.
    """
    free = list(figures["scale from none"])
    if free:
        text = f"Nothing defines the scale of {listed(free)}: all lengths there may be wrong by one factor."
        yield Check("scale", "", float(len(free)), 0.0, "1", FAIL, text)
        return
    columns = [] if lengths is None else [lengths.column(name).to_pylist() for name in ("bar", "serves")]
    serving = dict(zip(*columns, strict=True)) if columns else {}
    known = {source: len(figures[f"scale from {source}"]) for source in ("scale bars", "known points", "markers")}
    if (contradiction := scale_contradiction(figures)) is not None:
        yield Check("scale", "", 1e3 * abs(contradiction.by), 0.0, "mm/m", FAIL, contradiction.sentence)
        return
    checks = _checked_by(serving, figures, surveyed)
    text = f"{sum(known.values())} poses have a scale, from {' and '.join(_sources(serving, known))}"
    if checks:
        text += f", checked by {' and '.join(checks)}."
    else:
        text += " alone. Nothing checks it: were it in another unit, or wrong by a factor, all lengths would be, and "
        text += "nothing would tell."
    yield Check("scale", "", 0.0, 0.0, "1", PASS, text)


def _sources(serving: dict[str, str], known: dict[str, int]) -> list[str]:
    """Return the sources of the scale in words.

    ``serving``: role of each bar; ``known``: number of poses by kind of known geometry.
    """
    bars = [bar for bar, serves in serving.items() if serves == "scale" and not bar.startswith(_NO_BAR)]
    sources = [f"scale bar{'s' if len(bars) > 1 else ''} {listed(bars)}"] if bars else []
    for start, words in ((FROM_SURVEY, "distances of the survey"), (FROM_MARKER, "diagonals of markers and boards")):
        count = sum(bar.startswith(start) for bar in serving)
        sources += [f"{count} {words}"] if count else []
    sources += ["known points"] if known["known points"] else []
    return sources + (["the size of markers"] if known["markers"] else [])


def _checked_by(serving: dict[str, str], figures: Figures, surveyed: bool) -> list[str]:
    """Return in words the lengths that would reveal a wrong scale; a survey that defines the scale itself cannot."""
    checks = [bar for bar, serves in serving.items() if serves == "check"]
    bars = [bar for bar, serves in serving.items() if serves == "scale" and not bar.startswith(_NO_BAR)]
    references = [f"reference length{'s' if len(checks) > 1 else ''} {listed(checks)}"] if checks else []
    references += ["each other"] if len(bars) > 1 else []
    references += ["the survey"] if surveyed and not any(bar.startswith(FROM_SURVEY) for bar in serving) else []
    return references + [f"the width of {kind}" for kind in figures[_SIZES]]


def target_sizes(figures: Figures, limits: CampaignLimits) -> Iterator[Check]:
    """Yield the check of measured target sizes, on the determined scale, against stated ones."""
    sizes = figures[_SIZES]
    if not sizes:
        why = "no target has a stated size and was seen, except those that define the scale"
        yield not_evaluated("sizes of targets", "target-sizes", "", why)
    for kind, ratio in sizes.items():
        text = f"{kind}: they are {ratio:.3g} times as wide as stated (target_mm, marker_mm, image_targets.csv)."
        yield limits.of("target-sizes").row(kind, max(ratio, 1.0 / ratio), "times", text)


def bar_lengths(lengths: pa.Table | None, limits: CampaignLimits) -> Iterator[Check]:
    """Each scale bar as adjusted, distances of a survey and sizes of markers together; errors of reference lengths."""
    if lengths is None or not lengths.num_rows:
        yield not_evaluated("scale bars", "bar-lengths", "", "no pose shows both ends of any bar")
        yield not_evaluated("length errors", "length-errors", "", "no reference length checks the scale")
        return
    names = text_column(lengths, "bar").astype(str)
    ends = text_column(lengths, "first").astype(str)
    subjects = np.array([_subject(name, first) for name, first in zip(names, ends, strict=True)], dtype=object)
    for subject in dict.fromkeys(subjects):
        yield _bar(subject, lengths.filter(subjects == subject), limits)
    checking = rows_of(lengths, "serves", "check")
    if not checking.num_rows:
        yield not_evaluated("length errors", "length-errors", "", "no reference length checks the scale")
        return
    errors_found, length = _errors(checking), number_column(checking, "length_mm")
    error = 1e3 * errors_found.error_m
    relative = 1e6 * error / length
    worst = int(np.argmax(np.abs(relative)))
    text = f"{len(error)} reference lengths from {length.min():.0f} to {length.max():.0f} mm: errors of "
    text += f"{np.sqrt(np.mean(error**2)) * 1e3:.1f} um (rms), {relative[worst]:+.1f} um/m at most ("
    text += f"{checking.column('bar').to_pylist()[worst]} in pose {checking.column('pose').to_pylist()[worst]})."
    text += f" In common they have {1e6 * errors_found.scale:+.1f} ± {1e6 * errors_found.sigma_scale:.1f} um/m."
    text += (
        f" For an acceptance test the guideline asks for more: {'; '.join(errors_found.lacks)}."
        if errors_found.lacks
        else ""
    )
    yield limits.of("length-errors").row("", float(np.abs(relative[worst])), "um/m", text)


def _errors(checking: pa.Table) -> LengthErrors:
    """Errors of reference lengths; their part common to all poses is left to the scale, reported next to them."""
    measured, calibrated = number_column(checking, "adjusted_mm"), number_column(checking, "length_mm")
    sigma = 1e-3 * number_column(checking, "adjusted_sigma_mm")
    _, line = np.unique(text_column(checking, "bar").astype(str), return_inverse=True)
    lengths = CalibratedLengths(1e-3 * calibrated, 1e-3 * number_column(checking, "sigma_mm"), line=line)
    return length_errors(1e-3 * measured, np.diag(sigma**2), lengths)


def _subject(bar: str, first: str) -> str:
    """Return the subject of a length: each bar alone, survey distances by body, all markers together."""
    if bar.startswith(FROM_SURVEY):
        return f"survey of {first.rpartition('/')[0]}".removesuffix(" of ")
    return "markers and boards" if bar.startswith(FROM_MARKER) else f"bar {bar}"


def _bar(subject: str, rows: pa.Table, limits: CampaignLimits) -> Check:
    deviation, sigma = number_column(rows, "deviation_mm"), number_column(rows, "deviation_sigma_mm")
    determined = sigma > 1e-6 * number_column(rows, "length_mm") * 1e-3
    if not determined.any():
        why = "it alone defines the scale, so its adjusted length equals the calibrated one"
        return not_evaluated("deviation of the bar", "bar-lengths", subject, why)
    over = np.where(determined, np.abs(deviation) / np.where(determined, sigma, 1.0), 0.0)
    worst = int(np.argmax(over))
    limit, name = limits.of("bar-lengths"), rows.column("bar").to_pylist()[worst]
    off = f"{1e3 * deviation[worst]:+.1f} ± {1e3 * sigma[worst]:.1f} um from its"
    length, pose = number_column(rows, "length_mm")[worst], rows.column("pose").to_pylist()[worst]
    if not name.startswith(_NO_BAR):
        text = (
            f"Bar {name} ({rows.column('serves').to_pylist()[0]}) is {off} calibrated {length:.3f} mm in pose {pose}, "
        )
        text += f"the furthest of {count_text(len(over), 'pose')}."
    else:
        far = int(sum(limit.verdict(float(ratio)) != PASS for ratio in over))
        count, poses = (len(set(rows.column(column).to_pylist())) for column in ("bar", "pose"))
        text = (
            f"{subject}: {count_text(count, 'distance')} in {count_text(poses, 'pose')}, {far} of "
            f"{len(over)} beyond the limit; the largest, "
        )
        text += f"{name.partition(', ')[2]}, is {off} {length:.3f} mm in pose {pose}."
    return limit.row(subject, float(over[worst]), "sigma", text)
