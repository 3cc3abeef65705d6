"""A design in words: chosen configurations or loads, their efficiency, and comparison with existing ones."""

from __future__ import annotations

import numpy as np

from truing.calibration.needed_configurations import NeededConfigurations
from truing.estimation.design.pose_selection import efficiency
from truing.estimation.interferometry.recorded_steps import LOADS
from truing.report.numbers import count_text, percent
from truing.simulation.mechanisms.parameters import LegParameter
from truing.stages.configurations.chosen import Design, LoadPlan
from truing.stages.configurations.order_sentences import order_sentences, percent_of
from truing.stages.configurations.tables import STEPS_PER_RUN

_UNITS = {"mm": " mm", "1": ""}
_WITHIN = {"workspace": "within the limits of pose and readings in [workspace]", "actuators": "within rho_mm alone"}


def design_lines(design: Design) -> list[str]:
    """Return the output lines of a design."""
    return [
        *_parameters_chosen(design),
        *_quality(design),
        *_sigmas(design),
        *_needed(design),
        *_order(design),
        *_existing(design),
    ]


def _parameters_chosen(design: Design) -> list[str]:
    options, names = design.options, [entry.name for entry in design.problem.names]
    kept_words = "" if design.kept is None else f" next to {design.kept.count} that are kept"
    held_out_words = f" and {options.verification} for verification" if options.verification else ""
    first = f"{count_text(options.poses, 'configuration')}{held_out_words} by {options.method}{kept_words}, "
    first += _WITHIN[options.within]
    if design.kept is not None and design.kept.outside:
        first += f" ({design.kept.outside} of those kept lie outside)"
    held_out_words = ", ".join(design.problem.held)
    if design.kept is None and "reference" not in design.table.column("role").to_pylist():
        first += "; the reference configuration is forbidden, and left out"
    left = (
        f"; held: {held_out_words}, {'not asked for' if options.parameters else 'not distinguishable from these'}"
        if held_out_words
        else ""
    )
    return [
        first,
        f"parameters of each leg: {' '.join(names)} ({len(names)} x {count_text(design.problem.legs, 'leg')}){left}",
    ]


def _quality(design: Design) -> list[str]:
    best = design.candidates.upper
    return [
        f"O1 = log det J'J = {design.all_configurations.log_det:.3f} (parameters in tolerances, residuals in their "
        f"noise: {_noise(design)})",
        f"D-efficiency {percent_of(design.efficiency)} of the best possible, {best:.3f} ({_bound(design)})",
    ]


def _bound(design: Design) -> str:
    """Return the candidates of the bound in words."""
    candidates, size = design.candidates, design.problem.size
    ascended_words = f", {candidates.ascended} that climbs between them found" if candidates.ascended else ""
    missed = f", {candidates.unreached} more out of reach" if candidates.unreached else ""
    points = f"{count_text(candidates.corners, 'corner')} of the range, {count_text(candidates.dense, 'point')} in it"
    over = f"equivalence theorem over {points}{missed}{ascended_words}"
    if candidates.raised <= 1e-9 * size:
        return f"{over}; climbs find nothing more sensitive"
    return f"{over}; raised by the {percent(100 * float(np.expm1(candidates.raised / size)))} that climbs find beyond"


def _noise(design: Design) -> str:
    least, most = design.problem.noise.min() * 1e6, design.problem.noise.max() * 1e6
    size = f"{least:.2f} um" if most - least < 0.005 else f"{least:.2f} to {most:.2f} um"
    return f"{size}, {design.problem.noise_from}"


def _sigmas(design: Design) -> list[str]:
    """Return the table of predicted standard deviations: best and worst leg of each parameter."""
    lines = ["predicted sigma of   best leg           worst leg          tolerance"]
    return lines + [_sigma_line(design, k, entry) for k, entry in enumerate(design.problem.names)]


def _sigma_line(design: Design, k: int, entry: LegParameter) -> str:
    tolerance = design.problem.tolerance[k]
    sigma = design.all_configurations.sigma[:, k] * tolerance / entry.si
    best, worst = int(np.argmin(sigma)), int(np.argmax(sigma))
    unit = _UNITS[entry.unit]
    cells = [f"{sigma[leg]:.3g}{unit} (leg {leg + 1})" for leg in (best, worst)]
    return f"  {entry.name:18} {cells[0]:18} {cells[1]:18} {tolerance / entry.si:.3g}{unit}"


def _needed(design: Design) -> list[str]:
    """Return the least number of configurations of each model."""
    model_texts = [f"{need.model} {need.configurations} ({_counted_parameters(need)})" for need in design.needed]
    if not model_texts:
        return []
    return [f"least number of configurations by model, for what its limits separate: {', '.join(model_texts)}"]


def _counted_parameters(needed: NeededConfigurations) -> str:
    shared = f", {needed.shared} of them shared by the legs" if needed.shared else ""
    return f"{count_text(needed.parameters, 'parameter')}{shared}, {count_text(needed.equations, 'equation')} per pose"


def _order(design: Design) -> list[str]:
    return order_sentences(design.order, 1e3, "mm", "the longest drive", "regressors of the worst leg")


def _existing(design: Design) -> list[str]:
    existing_plan, share = design.existing, design.existing_efficiency
    if existing_plan is None or share is None:
        return []
    line = (
        f"the campaign's own {count_text(existing_plan.count, 'pose')}: O1 = {existing_plan.log_det:.3f}, "
        f"{percent_of(share)} of the best of as many"
    )
    if existing_plan.outside:
        line += f"; {existing_plan.outside} of them lie outside these limits, where the bound does not hold"
    alike = design.all_configurations.log_det + design.problem.size * np.log(
        existing_plan.count / design.all_configurations.count
    )
    ratio = efficiency(alike, existing_plan.log_det, design.problem.size)
    return [line, f"one chosen pose is worth {ratio:.2f} of the campaign's own poses"]


def load_lines(plan: LoadPlan) -> list[str]:
    """Output lines of a plan of loads."""
    options = plan.options
    held_out_words = f" and {options.verification} for verification" if options.verification else ""
    at_once = "all components at once" if options.may_all_act else f"at most {options.at_once} at once"
    spread = [100.0 * sigma for sigma in plan.sigma]
    lines = [
        f"{count_text(options.poses, 'load')}{held_out_words} within [loading], {at_once}, in runs of {STEPS_PER_RUN} "
        "that begin and end without load",
        f"log det of the information about a channel's six sensitivities and its zero: {plan.chosen.log_det:.3f}",
        f"D-efficiency {100.0 * plan.chosen.efficiency:.2f} % of the best possible (equivalence theorem over "
        f"{count_text(plan.candidates, 'load')})",
        f"predicted sigma of a signal at full load, in hundredths of its noise{_microvolts(plan)}: "
        + ", ".join(f"{load} {sigma:.1f}" for load, sigma in zip(LOADS, spread, strict=True)),
        f"drift: of a line in time, loads can imitate {100.0 * plan.order.drift:.2f} % "
        f"({100.0 * plan.order.random_drift:.2f} % in a random order)",
    ]
    return lines + _existing_loads(plan)


def _microvolts(plan: LoadPlan) -> str:
    return "" if plan.signal_mv is None else f" of {plan.signal_mv:g} mV"


def _existing_loads(plan: LoadPlan) -> list[str]:
    existing_loads = plan.existing
    if existing_loads is None:
        return []
    if existing_loads.efficiency == 0.0:
        return [f"the campaign's own {len(existing_loads.loads)} loads do not determine a calibration"]
    size = len(LOADS) + 1
    worth = (
        np.exp((plan.chosen.log_det - existing_loads.log_det) / size) * len(existing_loads.loads) / plan.options.poses
    )
    return [
        f"the campaign's own {count_text(len(existing_loads.loads), 'load')}: "
        f"{percent_of(existing_loads.efficiency)} of the best of as many, all components at once",
        f"one chosen load is worth {worth:.2f} of the campaign's own loads",
    ]
