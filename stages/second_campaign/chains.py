"""Places of links in a second campaign, predicted by the nominal and by the extended chain."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from truing.arrays import Array, Mask
from truing.schemas.covariates import own_name
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.extended_model import ExtendedChain, identified_conditions, read_chain
from truing.simulation.mechanisms.chains.start_values import start_values
from truing.simulation.mechanisms.chains.tree import JointKind, Tree
from truing.stages.common.chain_gross_errors import gross_errors
from truing.stages.common.chain_measurements import (
    MeasuredLinks,
    chain_conditions,
    is_framed,
    measured_links,
    pose_frames,
    reference_link,
)
from truing.stages.common.chain_tables import joint_readings, tree_of
from truing.stages.common.point_arrays import pose_ids
from truing.stages.second_campaign.compared import EXTENDED, NOMINAL, PredictionErrors, SecondCampaign

_SAME = 1e-7  # m and rad, of the nominal transforms
_ARCSEC = np.pi / 648000.0
_QUANTITIES = (("position", "um", 1e-6), ("orientation", "arcsec", _ARCSEC))


def predicted_links(text: str, second: SecondCampaign) -> Iterator[PredictionErrors]:
    """Yield errors of positions (um) and orientations (arcsec) of every measured link by the nominal and the extended
    chain; places of base, tools and unsurveyed targets are fitted anew.

    Raises CampaignFaults where the second campaign is of another chain, ValueError where it lacks what effects follow.
    """
    extended = read_chain(text)
    if second.settings.mechanism.type != "chain":
        raise second.refuse("mechanism.type", "chain", second.settings.mechanism.type)
    tree = tree_of(second.tables["joints"])
    _check(extended, tree, second)
    measured, conditions, usable = _usable(second, tree)
    _check_columns(extended, conditions)
    nominal = conditions.subset(usable)
    names = [effect.cause.id for effect in extended.effects if effect.cause.is_persistent]
    words = f"with {', '.join(dict.fromkeys(names))}" if names else "zeros and links as identified"
    is_beyond = ((nominal.readings < extended.measured[0]) | (nominal.readings > extended.measured[1])).any(1)
    models = (NOMINAL, "as described", nominal), (EXTENDED, words, identified_conditions(extended, nominal))
    for by, model, measured_link in models:
        errors = _errors(tree, measured, measured_link, usable, second)
        for turned, (quantity, unit, si) in enumerate(_QUANTITIES):
            for link in dict.fromkeys(measured.channels.links):
                of_link = np.array([name == link for name in measured.channels.links])
                chosen = of_link & (measured.channels.is_rotation == bool(turned))
                if not chosen.any():
                    continue
                is_observed = measured.is_observed[usable][:, chosen]
                variance = np.trace(measured.cov[usable][:, chosen], axis1=-2, axis2=-1)
                noise = float(np.sqrt(variance[is_observed].mean())) / si if is_observed.any() else None
                size = np.sqrt(np.sum(errors[:, chosen] ** 2, -1))
                beyond = np.broadcast_to(is_beyond[:, None], is_observed.shape)[is_observed]
                name = f"{quantity} of {link}"
                yield PredictionErrors(by, model, name, unit, size[is_observed] / si, noise, beyond)


def _check(extended: ExtendedChain, tree: Tree, second: SecondCampaign) -> None:
    """Raise CampaignFaults where the nominal chain is not that of the model."""
    if tree.readings != extended.tree.readings:
        raise second.refuse("mechanism.joints", ", ".join(extended.tree.readings), ", ".join(tree.readings))
    if tuple(tree.links) != tuple(extended.tree.links):
        raise second.refuse("mechanism", f"the links {', '.join(extended.tree.links)}", ", ".join(tree.links))
    for node, other in zip(extended.tree.nodes, tree.nodes, strict=True):
        if max(np.abs(node.t - other.t).max(), np.abs(node.R - other.R).max(), abs(node.shift - other.shift)) > _SAME:
            raise second.refuse(
                "mechanism", f"the same nominal place of joint {node.joint or node.link} as in the model"
            )


def _check_columns(extended: ExtendedChain, conditions: ChainConditions) -> None:
    """Raise ValueError where the second campaign lacks a column that an effect follows."""
    joints = len(extended.tree.readings)
    needed = {name for effect in extended.effects if effect.cause.is_persistent for name in effect.cause.needs(joints)}
    if missing := sorted(own_name(name) for name in needed - set(conditions.covariates)):
        raise ValueError(f"the extended model follows {', '.join(missing)}, which the second campaign does not hold")


def _usable(second: SecondCampaign, tree: Tree) -> tuple[MeasuredLinks, ChainConditions, Mask]:
    """Return the measurements, their conditions, and the poses that have readings and a frame."""
    table = second.tables["configurations"]
    measured = measured_links(second.tables, tree, pose_ids(table), gross_errors)
    readings = joint_readings(tree, table)
    usable = np.isfinite(readings).all(1) & measured.is_observed.any(1)
    usable &= is_framed(measured, reference_link(second.settings, measured))
    if not usable.any():
        raise ValueError("needs poses with readings of all joints and measured links")
    return (
        measured,
        chain_conditions(tree, table, second.settings, measured.reference, readings, usable, measured.coupling),
        usable,
    )


def _errors(
    tree: Tree, measured: MeasuredLinks, conditions: ChainConditions, usable: Mask, second: SecondCampaign
) -> Array:
    """Return measured minus predicted (B, K, 3), m and rad, after the unknown places were fitted."""
    values, base = measured.values[usable], None
    if (link := reference_link(second.settings, measured)) is not None:
        R, t = pose_frames(measured, link, usable)
        values = np.einsum("bji,bkj->bki", R[usable], values - t[usable][:, None])
        if measured.channels.node[link[0]] == 0 and np.isfinite(measured.surveyed[link]).all():
            base = np.eye(3)[None], np.zeros((1, 3))
    # The model holds the errors of a link's end only where no joint moves it against the joint below.
    is_fixed = [node.parent < 0 or node.kind is JointKind.FIXED for node in tree.nodes]
    surveyed = np.where(np.array(is_fixed)[measured.channels.node][:, None], measured.surveyed, np.nan)
    return start_values(
        tree, measured.channels, conditions, values, measured.is_observed[usable], surveyed, base
    ).errors
