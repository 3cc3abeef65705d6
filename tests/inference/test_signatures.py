"""Signatures by channel agree with those of the dense columns, also for one target at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.inference import toy_campaign as toy
from tests.tolerance import assert_close
from truing.inference import signatures
from truing.inference.arrays import Array
from truing.inference.channel_signatures import channel_signatures, rotated_channels
from truing.inference.signatures import Pathways, Signature, joint, signature, signatures_of

RNG = np.random.default_rng(3)
FOUND = toy.measured(RNG)
CHANNELS = toy.channels(FOUND)


def dense(columns: NDArray) -> NDArray:
    """Columns (B, M, P) as rows of the whole problem, free of everything unknown: one large least-squares fit."""
    poses, rows, local = toy.TEMPLATE.by_local.shape
    height = rows + local
    whole = np.zeros((poses * height + toy.SHARED, toy.SHARED + poses * local))
    full = np.zeros((len(whole), columns.shape[-1]))
    for pose in range(poses):
        own, place = slice(pose * height, pose * height + rows), toy.SHARED + pose * local
        whole[own, : toy.SHARED] = toy.TEMPLATE.by_shared[pose]
        whole[own, place : place + local] = toy.TEMPLATE.by_local[pose]
        whole[own.stop : own.stop + local, place : place + local] = np.eye(local)
        full[own] = columns[pose]
    whole[poses * height :, : toy.SHARED] = np.eye(toy.SHARED)
    return full - whole @ np.linalg.lstsq(whole, full, rcond=None)[0]


def columns_of_gain() -> NDArray:
    motion = toy.TEMPLATE.by_local[..., toy.READINGS]
    return motion @ toy.gain()["drive"]


def test_a_signature_has_the_strengths_of_its_dense_columns() -> None:
    own = signature(CHANNELS, toy.gain())
    assert_close(np.sort(own.strengths)[::-1], np.linalg.svd(dense(columns_of_gain()), compute_uv=False), atol=1e-7)


def test_scores_give_the_least_squares_parameters() -> None:
    own = signature(CHANNELS, toy.gain())
    scores = CHANNELS.along(FOUND.rest[None])[0][:, own.index].ravel() @ own.unit_design
    wanted = np.linalg.lstsq(dense(columns_of_gain()), FOUND.rest, rcond=None)[0]
    assert_close(own.fitted(scores), wanted, atol=1e-9)


def test_half_the_digits_are_enough_for_draws() -> None:
    rows = RNG.normal(size=(4, len(FOUND.rest)))
    assert_close(CHANNELS.along(rows.astype(np.float32)), CHANNELS.along(rows), atol=2e-3)


def test_a_target_that_was_moved_is_scored_as_its_dense_columns_are() -> None:
    shapes, point = toy.onsets(), 4
    turns = np.linalg.qr(RNG.normal(size=(toy.POSES, toy.POINTS, 3, 3)))[0]
    usable = np.ones((len(shapes), toy.POINTS), bool)
    own = channel_signatures(rotated_channels(CHANNELS, np.arange(toy.POINTS), turns), shapes, usable)
    squares = own.squares(own.rotated.along(CHANNELS.along(FOUND.rest[None])[:, :, CHANNELS.places["observed"]]))[0]
    columns = np.zeros((toy.POSES, toy.POINTS, 3, 3))
    columns[:, point] = shapes[7][:, :, None] * turns[:, point]
    left = dense(columns.reshape(toy.POSES, -1, 3))
    explained = left @ np.linalg.lstsq(left, FOUND.rest, rcond=None)[0]
    assert_close(squares[7, point], explained @ explained, atol=1e-7)


def test_points_that_hold_together_are_scored_as_their_dense_columns_are() -> None:
    shapes, members = toy.onsets(), np.array([[0, 2, 5], [1, 3, 4]])
    turns = np.linalg.qr(RNG.normal(size=(toy.POSES, toy.POINTS, 3, 3)))[0]
    patterns, usable = RNG.normal(size=(2, 3, 3, 4)), np.ones((len(shapes), 2), bool)
    own = channel_signatures(rotated_channels(CHANNELS, members, turns, patterns), shapes, usable)
    squares = own.squares(own.rotated.along(CHANNELS.along(FOUND.rest[None])[:, :, CHANNELS.places["observed"]]))[0]
    columns = np.zeros((toy.POSES, toy.POINTS, 3, 4))
    columns[:, members[1]] = shapes[7][:, :, None, None] * (turns[:, members[1]] @ patterns[1])
    left = dense(columns.reshape(toy.POSES, -1, 4))
    explained = left @ np.linalg.lstsq(left, FOUND.rest, rcond=None)[0]
    assert_close(squares[7, 1], explained @ explained, atol=1e-7)


def test_two_candidates_together_span_what_their_columns_span() -> None:
    design = toy.gain()["drive"]
    first, second = (signature(CHANNELS, {"drive": design[..., part]}) for part in (slice(0, 1), slice(1, 3)))
    strengths, _ = joint(CHANNELS, first, second)
    assert_close(np.sort(strengths), np.sort(signature(CHANNELS, toy.gain()).strengths), atol=1e-7)


def test_a_candidate_that_acts_on_nothing_is_not_seen() -> None:
    assert signature(CHANNELS, {}).rank == 0
    assert signature(CHANNELS, {"drive": np.zeros((toy.POSES, toy.DRIVES, 1))}).rank == 0


@pytest.mark.parametrize("values_at_once", [1, 2**18])
def test_candidates_together_have_the_signatures_that_each_has_alone(
    values_at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some act on the same inputs, with other numbers of parameters, from another epoch on; one acts on nothing."""
    monkeypatch.setattr(signatures, "_AT_ONCE", values_at_once)
    rng = np.random.default_rng(8)
    own = toy.channels(toy.measured(np.random.default_rng(0)))
    late = np.where(np.arange(toy.POSES) < toy.POSES // 2, 0.0, 1.0)[:, None, None]
    wide = rng.normal(size=(toy.POSES, toy.DRIVES, 2))
    first = np.eye(toy.DRIVES)[:, :1]
    designs = [{"drive": wide}, {"drive": wide[..., :1] * late}, {}, {"drive": wide * first}, {"drive": wide[:1]}]
    for together, alone in zip(signatures_of(own, designs), (signature(own, d) for d in designs), strict=True):
        assert together.rank == alone.rank
        assert_close(together.gram, alone.gram, atol=1e-9, what="gram")
        assert_close(together.explained, alone.explained, atol=1e-9, what="explained")
        assert_close(together.strengths, alone.strengths, atol=1e-9, what="strengths")


def test_candidates_that_act_in_the_same_few_epochs_are_one_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    batches: list[int] = []

    def counted(pathways: Pathways, alike: Sequence[Any], explained: Array) -> list[Signature]:
        batches.append(len(alike))
        return batch(pathways, alike, explained)

    batch = signatures._batch
    monkeypatch.setattr(signatures, "_batch", counted)
    wide = np.random.default_rng(8).normal(size=(toy.POSES, toy.DRIVES, 6))
    starts = np.array([0, 0, 0, toy.POSES // 2, toy.POSES // 2, toy.POSES - 1])
    acts = np.arange(toy.POSES)[:, None] == starts
    signatures_of(CHANNELS, [{"drive": wide[..., n : n + 1] * acts[:, None, n : n + 1]} for n in range(6)])
    assert sorted(batches) == [1, 2, 3]
