"""Checks of an open chain: joint readings, masses, copied poses, and the points of each link."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Mask
from truing.belonging.copied_poses import relate_copied_numbers
from truing.belonging.relation import RelationState, RelationTest, SlipKind
from truing.belonging.weights import Weights, relate_weights
from truing.estimation.rigid_poses.points import PosePoints
from truing.quality.bodies import PoseSurroundings
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.measured_lines import with_ground
from truing.simulation.mechanisms.chains.tree import JointKind, Tree
from truing.stages.common.chain_description import rows_of
from truing.stages.common.chain_distances import fit_of_distances, measured_distances
from truing.stages.common.chain_measurements import (
    MeasuredLinks,
    Screen,
    chain_conditions,
    excluded_poses,
    is_framed,
    measured_links,
    reference_link,
)
from truing.stages.common.chain_start import NominalFit, nominal_fit
from truing.stages.common.chain_tables import joint_readings, payload_of, tree_of
from truing.stages.common.point_arrays import pose_ids
from truing.stages.quality import point_checks
from truing.stages.quality.belonging import READINGS, belonging_checks
from truing.stages.quality.chain_readings import hidden_slips, not_tested, readings_tested
from truing.stages.quality.chain_slips import FEWEST_POSES, ComparedChain
from truing.stages.quality.check import Check, CheckResults
from truing.stages.quality.orientation_checks import FRAMES_DIFFER, orientation_test

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.chain_mechanism import ChainMechanism

_DISTANCES = "distances"
_OF_FRAMES = ("poses-determined", "geometry", "geometry-line", "geometry-plane", "geometry-leverage")
_FEWEST = 3
_MM = 1e-3


def checks(tables: Mapping[str, pa.Table], settings: Campaign) -> CheckResults:
    """Checks of joint readings against links, and of object points but for frames of links with few targets."""
    of_links = any(name in tables and tables[name].num_rows for name in ("observations", "measured_poses"))
    of_distances = "distances" in tables and tables["distances"].num_rows > 0
    tested = [joints_against_links(tables, settings)] if of_links or not of_distances else []
    tested += [joints_against_distances(tables, settings)] if of_distances else []
    results = point_checks.checks(tables, settings)
    tested += copies_of_links(tables, settings)
    tested += [masses_against_lengths(tables, settings)] if "joints" in tables else []
    if results.why_not and all(test.state is RelationState.NOT_TESTED for test in tested):
        return results
    relations = (*tested, *(relation for relation in results.relations if relation.relation != READINGS))
    read = results.read or f"{len(tables['configurations'])} poses of a chain"
    single = set() if results.why_not else _single(tables["observations"])
    of_times = point_checks.checks_of_times(tables, settings)
    loose = of_times if results.why_not else _without_frames(results, single, _framing(tables, settings))
    return replace(results, checks=chain(belonging_checks(tested), loose), read=read, relations=relations, why_not="")


def joints_against_links(tables: Mapping[str, pa.Table], settings: Campaign) -> RelationTest:
    """Test that the nominal chain at the joint readings reaches the measured places, up to a calibration."""
    if "joints" not in tables or not any(
        name in tables and tables[name].num_rows for name in ("observations", "measured_poses")
    ):
        return not_tested("no-poses")
    try:
        compared = _links_compared(tables, settings)
        if compared is None:
            return not_tested("no-poses")
        turned = orientation_test(compared, settings, tables.get("measured_poses"))
        if (
            turned is not None
            and turned.state is RelationState.FAILS
            and (turned.slips or turned.reason == FRAMES_DIFFER)
        ):
            return turned
        tested = readings_tested(compared, settings)
        # Single strays of orientations lead only where the positions agree.
        if (
            turned is not None
            and not tested.slips
            and (turned.state is not RelationState.ATTENTION or tested.state is RelationState.OK)
        ):
            return turned
        if tested.slips and all(slip.kind is SlipKind.STRAY for slip in tested.slips):
            # A wrong target bends the frame of its link: the pose misses, though its readings are right.
            compared = _links_compared(tables, settings, _away_from_shape)
            return tested if compared is None else readings_tested(compared, settings)
        return tested
    except ValueError:
        return not_tested("no-frame")


def masses_against_lengths(tables: Mapping[str, pa.Table], settings: Campaign) -> RelationTest:
    """Test declared masses and their centres by the reach of the chain."""
    tree, table, section = (
        tree_of(tables["joints"]),
        tables["configurations"],
        cast("ChainMechanism", settings.mechanism),
    )
    readings = joint_readings(tree, table)
    travel = np.nan_to_num(np.nanmax(readings, axis=0, initial=0.0) - np.nanmin(readings, axis=0, initial=0.0))
    lengths = sum(float(np.sqrt(np.sum(node.t**2))) for node in tree.nodes)
    return relate_weights(
        Weights(
            np.array([node.mass for node in tree.nodes]),
            np.array([node.com for node in tree.nodes]),
            float(np.max(payload_of(settings, table), initial=0.0)),
            _MM * np.array(section.payload_com_mm or (0.0, 0.0, 0.0)),
            lengths + float(travel[~tree.is_revolute].sum()),
            all(node.mass > 0.0 for node in tree.nodes if node.kind is not JointKind.FIXED),
            _next_joints(tree),
            [node.link for node in tree.nodes],
        )
    )


def _next_joints(tree: Tree) -> Array:
    """Return the place (N, 3), m, of the next joint of each link in its frame; zero of outer links."""
    ends = np.zeros((len(tree.nodes), 3))
    for node in reversed(tree.nodes):
        if node.parent >= 0:
            ends[node.parent] = node.t
    return ends


def copies_of_links(tables: Mapping[str, pa.Table], settings: Campaign) -> list[RelationTest]:
    """The tests that no two measured poses, and no two rows of distances, are equal in every digit."""
    if "joints" not in tables:
        return []
    tree, poses = tree_of(tables["joints"]), pose_ids(tables["configurations"])
    found = []
    if "measured_poses" in tables and tables["measured_poses"].num_rows:
        measured = measured_links({"measured_poses": tables["measured_poses"]}, tree, poses)
        used, turned = measured.is_position, measured.channels.is_rotation
        found.append(_copies(measured, used, poses, "measurements", measured.reference[:, turned]))
    if "distances" in tables and tables["distances"].num_rows:
        measured = measured_distances(tables, with_ground(tree), poses)
        assert measured.ends is not None
        used = np.arange(measured.values.shape[1]) >= measured.values.shape[1] - len(measured.ends)
        found.append(_copies(measured, used, poses, _DISTANCES))
    return found


def _copies(
    measured: MeasuredLinks, used: Mask, poses: tuple[int | str, ...], quantity: str, also: Array | None = None
) -> RelationTest:
    """The test that the used channels (K,), m, are not equal in every digit in two poses."""
    is_observed = measured.is_observed[:, used]
    sigma = np.sqrt(np.diagonal(measured.cov[:, used], axis1=-2, axis2=-1))[is_observed]
    numbers = measured.values[:, used].reshape(len(poses), -1)
    seen = np.repeat(is_observed, measured.values.shape[-1], axis=1)
    least = float(np.nanmin(sigma)) if sigma.size else 0.0
    names = tuple(map(str, poses))
    orientations = None if also is None else also.reshape(len(poses), -1)
    return relate_copied_numbers(numbers, seen, least, names, quantity, orientations)


def _away_from_shape(tables: Mapping[str, pa.Table], body: str, points: PosePoints) -> Mask:
    """Mask (B, T) of the points of a body that do not fit its other points."""
    alone = PoseSurroundings(
        points.poses, np.arange(float(len(points.poses))), np.zeros((len(points.poses), 0)), (), None, is_counted=True
    )
    view = point_checks.viewed(tables["observations"], tables.get("survey"), body, alone)
    is_out_of_place = np.zeros(points.is_observed.shape, bool)
    is_out_of_place[:, [points.targets.index(name) for name in view.survey.targets]] = view.gross
    return is_out_of_place


def _links_compared(
    tables: Mapping[str, pa.Table], settings: Campaign, wrong: Screen | None = None
) -> ComparedChain | None:
    """Return the chain and what was measured on its links, without the points ``wrong``; None for too few poses."""
    tree, table = tree_of(tables["joints"]), tables["configurations"]
    measured = measured_links(tables, tree, pose_ids(table), wrong)
    usable = _usable(tree, table, measured)
    usable &= is_framed(measured, reference_link(settings, measured))
    usable &= ~excluded_poses(settings.exclude, pose_ids(table))
    if usable.sum() < FEWEST_POSES:
        return None
    compared = _compared(
        tree,
        table,
        settings,
        measured,
        usable,
        lambda other, conditions: nominal_fit(other, settings, measured, conditions, usable),
    )
    return replace(compared, fit_on=lambda other: nominal_fit(tree, settings, other, compared.conditions, usable))


def _compared(
    tree: Tree,
    table: pa.Table,
    settings: Campaign,
    measured: MeasuredLinks,
    usable: Mask,
    fit_of: Callable[[Tree, ChainConditions], NominalFit],
) -> ComparedChain:
    conditions = _conditions(tree, table, settings, measured, usable)
    rows = rows_of(cast("ChainMechanism", settings.mechanism))
    return ComparedChain(tree, table, measured, conditions, usable, rows, lambda other: fit_of(other, conditions))


def joints_against_distances(tables: Mapping[str, pa.Table], settings: Campaign) -> RelationTest:
    """Test that the nominal chain at the joint readings has the measured distances, up to a calibration."""
    tree, table = with_ground(tree_of(tables["joints"])), tables["configurations"]
    measured = measured_distances(tables, tree, pose_ids(table))
    usable = _usable(tree, table, measured)
    if usable.sum() < FEWEST_POSES:
        return not_tested("no-poses", _DISTANCES)
    # The ground, which stands next to the chain, is no row of its description.
    compared = _compared(
        tree,
        table,
        settings,
        measured,
        usable,
        lambda other, conditions: fit_of_distances(with_ground(other), measured, conditions, usable),
    )
    tested = replace(readings_tested(compared, settings), subject=_DISTANCES)
    if tested.state is not RelationState.OK:
        return tested
    return replace(tested, hidden=tuple(hidden_slips(compared)))


def _usable(tree: Tree, table: pa.Table, measured: MeasuredLinks) -> Mask:
    """Mask (B,) of the poses with readings of all joints, and a measurement."""
    return np.asarray(np.isfinite(joint_readings(tree, table)).all(1) & measured.is_observed.any(1))


def _conditions(
    tree: Tree, table: pa.Table, settings: Campaign, measured: MeasuredLinks, usable: Mask
) -> ChainConditions:
    readings = np.nan_to_num(joint_readings(tree, table))
    return chain_conditions(tree, table, settings, measured.reference, readings, usable, measured.coupling)


def _single(observations: pa.Table) -> set[str]:
    """Links with fewer than three targets."""
    pairs = set(zip(*(observations.column(name).to_pylist() for name in ("body", "target")), strict=True))
    links = [link for link, _ in pairs]
    return {link for link in links if links.count(link) < _FEWEST}


def _framing(tables: Mapping[str, pa.Table], settings: Campaign) -> str:
    """Link whose targets define the frame of each pose; empty if none does."""
    links = tree_of(tables["joints"]).links if "joints" in tables else {}
    measured = {link for link in tables["observations"].column("body").to_pylist() if link in links}
    return "" if settings.is_frame_fixed or len(measured) < 2 else min(measured, key=links.__getitem__)


def _without_frames(check_results: CheckResults, single: set[str], framing: str) -> Iterator[Check]:
    """Checks that concern a chain: it uses each target by itself, but for those that define the frame of a pose."""
    for check in check_results.checks:
        is_target = check.check == "geometry-leverage"
        of_frame = check.check in _OF_FRAMES and bool(single) and (check.subject in single or is_target)
        is_needless = check.check == "poses-determined" and check.subject != framing
        if check.check != READINGS and not of_frame and not is_needless:
            yield check
