"""Class `ExtendedModel`: an identified mechanism with its effects; prediction of poses, and model.toml.

In model.toml lengths are in mm. Unknowns are ordered by name: a, b, u, l leg by leg (u as two tilts across the nominal
direction), then effects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import rigid_motions, skew
from truing.schemas.settings_text import Document
from truing.simulation.catalogue import catalogue, catalogue_of_photographed_points
from truing.simulation.cause import Effect, Step
from truing.simulation.mechanisms.legs.closures import Legs, mechanism
from truing.simulation.mechanisms.model import MechanismModel, PriorKnowledge
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet, full_set
from truing.simulation.mechanisms.point_causes import PointCause
from truing.simulation.mechanisms.recording import FROM_PHOTOGRAPHS, Conditions
from truing.simulation.mechanisms.structures.structure import Machine
from truing.simulation.model_text import (
    context_of,
    covariance_from,
    effects_of,
    model_text,
    read_document,
    toml_value,
)
from truing.simulation.targets import BASE, LEG, PLATFORM, ShapeUnknowns, Targets

LEAST_FRAME = 3  # least number of targets away from attachments that define the frame of a body
# Number of poses per batch: derivatives of all targets by all unknowns need much memory.
_AT_ONCE = 128


@dataclass(frozen=True)
class ExtendedModel:
    """An identified mechanism: unknowns (G,) with covariance (G, G), in prior sigmas, at the estimated noise.

    The model's targets are those of base and platform at their surveyed positions; survey_sigma (K,), m, is the noise
    of their survey. ``context``: origin of the model, in words.
    """

    model: MechanismModel
    shared: NDArray
    covariance: NDArray
    survey_sigma: NDArray
    context: dict[str, str]

    @property
    def effects(self) -> tuple[Effect[PointCause], ...]:
        """Effects that were found."""
        return self.model.effects(self.shared)

    def covariance_of(self, cause: PointCause) -> NDArray:
        """Return the covariance (P, P) of an effect's parameters, SI."""
        part, sigma = self.model.layout[cause.key], self.model.effect_sigma(cause)
        return self.covariance[part, part] * np.outer(sigma, sigma)


@dataclass(frozen=True)
class PredictedPoses:
    """Predicted poses of the platform relative to the base, m and rad, and whether the legs closed.

    ``of_model`` is the part of the covariance due to the model's unknowns; it is common to the poses of the fit. Frames
    are defined by the bodies' targets away from the attachments, fitted to their survey.
    """

    p: NDArray  # (B, 3)
    R: NDArray  # (B, 3, 3)
    covariance: NDArray  # (B, 6, 6) of (p, theta), R <- exp(theta) R
    of_model: NDArray  # (B, 6, 6)
    converged: NDArray  # (B,)


def extended(model: MechanismModel, shared: NDArray, covariance: NDArray, context: dict[str, str]) -> ExtendedModel:
    """Return the extended model of a fit over targets: geometry and effects with their joint covariance."""
    on_body = model.targets.body != LEG
    parts = [part for name, part in model.layout.items() if name not in ("shape", "seat", FROM_PHOTOGRAPHS)]
    columns_kept = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    smaller = with_targets(model, on_body)
    sigma = survey_noise(model)[on_body]
    return ExtendedModel(smaller, shared[columns_kept], covariance[np.ix_(columns_kept, columns_kept)], sigma, context)


def with_targets(model: MechanismModel, targets_on_body: NDArray) -> MechanismModel:
    """Return the model with some of its targets (K,), none on a leg, at their surveyed positions."""
    all_targets, known = model.targets, model.known
    indices = np.flatnonzero(targets_on_body)
    names, bodies = (
        tuple(reported[k] for k in indices) if reported else () for reported in (all_targets.names, all_targets.bodies)
    )
    targets = Targets(all_targets.body[indices], all_targets.leg[indices], names, bodies)
    # The covariance already contains the prior knowledge.
    surveyed = replace(known, shape=known.shape[indices], survey=exact_survey(targets), carrying_legs=np.arange(0))
    conditions = replace(model.conditions, common_errors=None, pose_errors=None)
    alone = replace(model, photographed=None, prior_campaign=None)
    return replace(alone, targets=targets, known=surveyed, conditions=conditions)


def exact_survey(targets: Targets) -> ShapeUnknowns:
    """Return the unknowns of an exact survey: none."""
    return ShapeUnknowns(np.zeros((len(targets.body), 3, 0)), np.eye(3 * int(targets.at_attachment.sum())))


def survey_noise(model: MechanismModel) -> NDArray:
    """Return the survey noise (K,), m, of each body, from its unknown shape without the rigid motion."""
    squares = np.sum(model.known.survey.modes**2, (1, 2))
    sigma = np.zeros(len(squares))
    for body in np.unique(model.channel_groups):
        channels = (model.channel_groups == body) & ~model.targets.at_attachment
        free = 3 * channels.sum() - 6 * (body < LEG and channels.sum() >= LEAST_FRAME)
        sigma[model.channel_groups == body] = np.sqrt(squares[channels].sum() / max(free, 1))
    return sigma


def concerns_targets(cause: PointCause) -> bool:
    """True if a cause concerns single targets only, and so does not affect the poses of bodies."""
    settings = cause.settings()
    return bool(settings.get("target") or settings.get("targets"))


def acts_on_poses(cause: PointCause) -> bool:
    """True if a cause changes the pose of the platform, and not only its record."""
    return cause.step is not Step.INSTRUMENT and not concerns_targets(cause)


def persistent_part(extended_model: ExtendedModel) -> ExtendedModel:
    """Return the model with only the persistent effects, which do not end with their campaign."""
    smaller = extended_model.model.with_causes([cause for cause in extended_model.model.causes if cause.is_persistent])
    columns_kept = np.concatenate([np.arange(part.start, part.stop) for part in _parts(extended_model.model, smaller)])
    covariance = extended_model.covariance[np.ix_(columns_kept, columns_kept)]
    return replace(extended_model, model=smaller, shared=extended_model.shared[columns_kept], covariance=covariance)


def predict_poses(extended_model: ExtendedModel, conditions: Conditions, *, recorded: bool = False) -> PredictedPoses:
    """Return the platform's poses at the given conditions, with the uncertainty of unknowns and readings propagated.

    recorded: include errors of the campaign's instrument, such as a wrong scale; otherwise return true poses.
    """
    every = extended_model.model.causes
    causes = [cause for cause in every if acts_on_poses(cause) or (recorded and not concerns_targets(cause))]
    targets = extended_model.model.targets
    framing = with_targets(extended_model.model, (targets.leg < 0) & (targets.body != LEG)).with_causes(causes)
    columns_kept = np.concatenate([np.arange(part.start, part.stop) for part in _parts(extended_model.model, framing)])
    shared, covariance = (
        extended_model.shared[columns_kept],
        extended_model.covariance[np.ix_(columns_kept, columns_kept)],
    )
    count = len(conditions.readings)
    rows = [np.arange(first, min(first + _AT_ONCE, count)) for first in range(0, max(count, 1), _AT_ONCE)]
    predictions = [_predicted(framing.at(some_of(conditions, part)), shared, covariance) for part in rows]
    return PredictedPoses(*(np.concatenate(parts) for parts in zip(*predictions, strict=True)))


def _parts(model: MechanismModel, smaller: MechanismModel) -> list[slice]:
    """Return the slices of a smaller model's unknowns among those of the model."""
    return [model.layout[name] for name in smaller.layout]


def some_of(conditions: Conditions, rows: NDArray) -> Conditions:
    """Return the conditions of some poses, given by indices or a mask (B,)."""
    rows = np.arange(len(conditions.readings))[rows]
    covariates = {name: value[rows] for name, value in conditions.covariates.items()}
    poses = tuple(conditions.poses[row] for row in rows) if conditions.poses else ()
    factor = None if conditions.input_factor is None else conditions.input_factor[rows]
    return replace(
        conditions, readings=conditions.readings[rows], covariates=covariates, poses=poses, input_factor=factor
    )


def _predicted(
    model: MechanismModel, shared: NDArray, covariance: NDArray
) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray]:
    """Return poses, their covariance, the part of it due to the unknowns, and the mask of poses whose legs closed."""
    local = np.zeros((len(model.conditions.readings), model.local_size))
    state = model.state(shared, local)
    p, R = state.p, state.R
    if min(np.sum(model.targets.body == body) for body in (BASE, PLATFORM)) < LEAST_FRAME:
        by_shared, by_local = model.pose_derivatives(shared, local)
    else:
        predicted = model.predict(shared, local)
        p, R = _framed(model, predicted.values)
        by_shared, by_local = (
            _twists(model, predicted.values, p, by) for by in (predicted.by_shared, predicted.by_local)
        )
    of_model = by_shared @ covariance @ np.swapaxes(by_shared, 1, 2)
    return p, R, of_model + by_local @ np.swapaxes(by_local, 1, 2), of_model, state.converged


def _framed(model: MechanismModel, points: NDArray) -> tuple[NDArray, NDArray]:
    """Return the pose (B, 3), (B, 3, 3) of the platform's frame relative to the base's, fitted to targets (B, K, 3)."""
    base, platform = (
        umeyama(model.known.shape[model.targets.body == body], points[:, model.targets.body == body])
        for body in (BASE, PLATFORM)
    )
    back = np.swapaxes(base.R, 1, 2)
    return np.einsum("bij,bj->bi", back, platform.t - base.t), back @ platform.R


def _twists(model: MechanismModel, points: NDArray, p: NDArray, motions: NDArray) -> NDArray:
    """Return the twist (B, 6, P) of the platform's frame relative to the base's, from motions (B, K, 3, P) of
    targets."""
    origins = {BASE: np.zeros_like(p), PLATFORM: p}
    base, platform = (
        _twist(points[:, model.targets.body == body] - origin[:, None], motions[:, model.targets.body == body])
        for body, origin in origins.items()
    )
    carried = np.einsum("bij,bjp->bip", skew(p), base[:, 3:])
    return platform - base + np.concatenate([carried, np.zeros_like(carried)], 1)


def _twist(arms: NDArray, motions: NDArray) -> NDArray:
    """Return the least-squares twist (B, 6, P) of motions (B, n, 3, P) of points at arms (B, n, 3)."""
    rows = rigid_motions(arms)
    normal = np.einsum("bnij,bnik->bjk", rows, rows)
    return np.linalg.solve(normal, np.einsum("bnij,bnip->bjp", rows, motions))


def bare_known(
    geometry: dict[str, float], shape: NDArray, targets: Targets, legs: int, reading_sigma: float
) -> PriorKnowledge:
    """Return the prior knowledge of a mechanism without targets on legs, with an exact survey."""
    seats = np.tile(np.eye(3), (legs, 1, 1)), np.zeros((legs, 3))
    return PriorKnowledge(geometry, shape, exact_survey(targets), reading_sigma, np.arange(0), *seats)


_AXES = "xyz"
_BODIES = {"base": BASE, "platform": PLATFORM}
_OWN = ("mechanism", "reading_sigma_mm", "reference_temperature_c")


def write_model(extended_model: ExtendedModel) -> str:
    """Return the model as TOML text."""
    model, covariance = extended_model.model, extended_model.covariance
    identified, sigma = model.legs(extended_model.shared), np.sqrt(np.diag(covariance))
    numbers = {
        "mechanism": model.nominal.closure.name,
        "reading_sigma_mm": float(_mm(model.known.reading_sigma)),
        "reference_temperature_c": model.known.reference_temperature_c,
    }
    tables = ["", *_prior(model)]
    for leg in range(model.part_count):
        tables += ["", "[[legs]]", f"nominal = {_leg(model.nominal, leg)}", f"identified = {_leg(identified, leg)}"]
        tables += [f"sigma = {_leg_sigma(model, sigma, leg)}"]
    units, survey = "their prior standard deviations", _targets(extended_model)
    return model_text(extended_model, numbers, tables, survey, names=_names(model), units=units, legs=model.part_count)


def read_model(text: str) -> ExtendedModel:
    """Read the model from a text of `write_model`; raises ValueError if the text is no such model."""
    return read_document(text, _from_document)


def _prior(model: MechanismModel) -> list[str]:
    """Return the lines of the table with the prior sigmas of the geometry."""
    known = model.known
    sigmas = [f"{n} = {toml_value(known.geometry.get(n, 0.0))}  # {'rad' if n == 'u' else 'm'}" for n in "abul"]
    text = "[prior]  # one standard deviation of the nominal geometry; 0: taken as exact; open: only a start"
    return [text, *sigmas, f"open = {toml_value(known.open_geometry)}"]


def _leg(legs: Legs, leg: int) -> str:
    joints = {f"{name}_mm": _mm(joint[leg]) for name, joint in (("a", legs.a), ("b", legs.b))}
    lengths = {"length_mm": _mm(legs.l[leg]), "rho0_mm": _mm(legs.rho0[leg])}
    return toml_value({**joints, "u": np.round(legs.u[leg], 13), **lengths})


def _leg_sigma(model: MechanismModel, sigma: NDArray, leg: int) -> str:
    parts: dict[str, object] = {}
    for name, size, key in (("a", 3, "a_mm"), ("b", 3, "b_mm"), ("u", 2, "tilt_rad"), ("l", 1, "length_mm")):
        if name in model.layout:
            leg_sigma = sigma[model.layout[name]].reshape(-1, size)[leg] * model.known.geometry[name]
            leg_sigma = [float(f"{value:.4g}") for value in leg_sigma * (1.0 if name == "u" else 1e3)]
            parts[key] = leg_sigma if size > 1 else leg_sigma[0]
    return toml_value(parts)


def _targets(extended_model: ExtendedModel) -> list[str]:
    """Return the lines of the table with the surveyed targets of base and platform."""
    model, bodies = extended_model.model, {kind: body for body, kind in _BODIES.items()}
    targets, lines = model.targets, []
    for k, position in enumerate(model.known.shape):
        reported: dict[str, object] = {
            "body": bodies[int(targets.body[k])],
            "target": targets.names[k] if targets.names else str(k),
        }
        reported |= {"leg": int(targets.leg[k]) + 1} if targets.leg[k] >= 0 else {}
        reported |= {"place_mm": _mm(position), "sigma_mm": _mm(extended_model.survey_sigma[k])}
        lines.append(f"  {toml_value(reported)},")
    return ["", "[survey]", "targets = [", *lines, "]"]


def _names(model: MechanismModel) -> list[str]:
    legs = range(1, model.nominal.count + 1)
    names: list[str] = []
    for name, parts in (("a", _AXES), ("b", _AXES), ("u", "12"), ("l", " ")):
        if name in model.layout:
            names += [f"{name}{leg}{f'_{part}' if part != ' ' else ''}" for leg in legs for part in parts]
    return names


def _mm(metres: object) -> NDArray:
    """Convert m to mm, rounded to 1e-12 mm."""
    return np.round(np.asarray(metres, float) * 1e3, 12)


def _from_document(document: Document) -> ExtendedModel:
    nominal, identified = (
        _legs(document["model"]["mechanism"], [leg[kind] for leg in document["legs"]])
        for kind in ("nominal", "identified")
    )
    effects = effects_of(document, catalogue() | catalogue_of_photographed_points())
    model = _model(document, nominal, tuple(effect.cause for effect in effects))
    shared = model.unknowns(identified, {effect.cause.key: effect.values for effect in effects})
    sigma = np.array([target["sigma_mm"] for target in document["survey"]["targets"]], float) * 1e-3
    covariance = covariance_from(document, model.shared_size)
    return ExtendedModel(model, shared, covariance, sigma, context_of(document, _OWN))


def _model(document: Document, nominal: Legs, causes: tuple[PointCause, ...]) -> MechanismModel:
    about, listed = document["model"], document["survey"]["targets"]
    targets = Targets(
        np.array([_BODIES[entry["body"]] for entry in listed], int),
        np.array([entry.get("leg", 0) - 1 for entry in listed], int),
        tuple(str(entry["target"]) for entry in listed),
        tuple(str(entry["body"]) for entry in listed),
    )
    positions = np.array([entry["place_mm"] for entry in listed], float).reshape(-1, 3) * 1e-3
    prior = dict(document["prior"])
    opened = tuple(prior.pop("open"))
    geometry = {name: float(sigma) for name, sigma in prior.items() if sigma > 0}
    known = bare_known(geometry, positions, targets, nominal.count, about["reading_sigma_mm"] * 1e-3)
    known = replace(known, open_geometry=opened, reference_temperature_c=about["reference_temperature_c"])
    return MechanismModel(targets, Conditions(nominal.rho0[None]), nominal, known, causes=causes)


def _legs(kind: str, legs: list[Document]) -> Legs:
    def lengths(name: str) -> NDArray:
        return np.array([leg[name] for leg in legs]) * 1e-3

    legs_of_model = mechanism(
        kind, lengths("a_mm"), lengths("b_mm"), [leg["u"] for leg in legs], lengths("length_mm"), lengths("rho0_mm")
    )
    return legs_of_model.replace(u=np.array([leg["u"] for leg in legs], float))


_TINY = 1e-30


@dataclass(frozen=True)
class IdentifiedGeometry:
    """P parameters of the geometry, SI: nominal and identified (P,), covariance and prior covariance (P, P).

    known (P,): whether the prior is a tolerance, not a wide default. by_shared (P, G): derivative by the model's
    unknowns.
    """

    parameters: tuple[LegParameter, ...]
    nominal: NDArray
    values: NDArray
    covariance: NDArray
    prior: NDArray
    known: NDArray
    by_shared: NDArray

    @property
    def sigma(self) -> NDArray:
        """Standard deviations (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def tolerance(self) -> NDArray:
        """Standard deviation (P,) by manufacturing and assembly; NaN if unknown."""
        return np.where(self.known, np.sqrt(np.diag(self.prior)), np.nan)


def identified_geometry(model: MechanismModel, shared: NDArray, covariance: NDArray) -> IdentifiedGeometry:
    """Return the geometry at shared unknowns (G,) with covariance (G, G); derivatives by complex step, exact."""
    every = full_set(_bare_machine(model.nominal), "none").entries
    entries = ParameterSet(tuple(entry for entry in every if _part(entry) in model.layout))
    by_shared = np.zeros((len(entries), model.shared_size))
    for name in ("a", "b", "u", "l"):
        for i in range(*model.layout.get(name, slice(0)).indices(model.shared_size)):
            nudged = shared + 1j * _TINY * (np.arange(len(shared)) == i)
            by_shared[:, i] = _values_of(entries, model.legs(nudged)).imag / _TINY
    return IdentifiedGeometry(
        entries.entries,
        _values_of(entries, model.nominal),
        _values_of(entries, model.legs(shared)),
        by_shared @ covariance @ by_shared.T,
        by_shared @ by_shared.T,
        np.array([_part(entry) not in model.known.open_geometry for entry in entries.entries], bool),
        by_shared,
    )


def _part(entry: LegParameter) -> str:
    return entry.name.partition("_")[0]


def _bare_machine(legs: Legs) -> Machine:
    return Machine(legs, np.zeros((legs.count, legs.count)), None, None, None)


def _values_of(entries: ParameterSet, legs: Legs) -> NDArray:
    return entries.values(_bare_machine(legs)) if len(entries) else np.zeros(0)


def name_and_leg(name: str) -> tuple[str, int | None]:
    """Split a parameter's name into name and leg: ``gain_3`` is ``gain`` of leg 3; ``K12`` stays, with leg 1."""
    head, _, leg = name.rpartition("_")
    if head and leg.isdigit() and not head.startswith("K"):
        return head, int(leg)
    if name.startswith("K") and name[1:].replace("_", "").isdigit():
        return name, int(head[1:] if head else name[1])
    return name, None
