"""Photographs of many targets with their true centres, for tests of what measures them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.estimation.image_targets.pictures import ellipse_picture, photograph, ring_target_picture

GROUND, CONTRAST = 30.0, 180.0


@dataclass(frozen=True)
class Scene:
    """A photograph, the centres (N, 2) of its targets in px, and of coded ones which word of the code it is (N,)."""

    grey: np.ndarray
    centre: np.ndarray
    word: np.ndarray


def assembled(rng, tiles, centres, words, noise, invert=False, margin=24):
    """Square tiles of light (N, s, s) side by side, in a margin without targets, photographed."""
    size, across = tiles[0].shape[0], int(np.ceil(np.sqrt(len(tiles))))
    light = np.zeros((across * size + 2 * margin,) * 2)
    centre = np.empty((len(tiles), 2))
    for k, (tile, own) in enumerate(zip(tiles, centres, strict=True)):
        y, x = (margin + size * i for i in divmod(k, across))
        light[y : y + size, x : x + size] = tile
        centre[k] = own[0] + x, own[1] + y
    grey = photograph(rng, 1 - light if invert else light, GROUND, CONTRAST, noise)
    return Scene(grey, centre, np.array(words))


def dots(rng, axes, blur, noise, count, slope=0.001, copies=1):
    """Ellipses of one shape at any angle and pixel phase, this many of each, under light of slopes per px."""
    size = int(2 * (2.2 * axes[0] + 4 * blur + 4))
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    tiles, centres = [], []
    for _ in range(count):
        centre = (size - 1) / 2 + rng.uniform(-0.5, 0.5, 2)
        covered = ellipse_picture(size, centre, axes, rng.uniform(-1.6, 1.6), blur)
        for _ in range(copies):
            across, down = slope * rng.normal(size=2)
            lit = (GROUND + CONTRAST * covered) * (1 + across * x + down * y)
            tiles.append((lit - GROUND) / CONTRAST)
            centres.append(centre)
    return assembled(rng, tiles, centres, [0] * len(tiles), noise)


def rings(rng, axes, blur, noise, bits, words, invert=False):
    """One ring target of each word, at any angle and turn."""
    size = int(8 * axes[0] + 6 * blur + 4)
    tiles, centres = [], []
    for word in words:
        centre = (size - 1) / 2 + rng.uniform(-0.5, 0.5, 2)
        turns = rng.uniform(-1.6, 1.6), rng.uniform(0, 6.28)
        tiles.append(ring_target_picture(size, centre, axes, turns[0], bits, word, turns[1], blur, fine=8))
        centres.append(centre)
    return assembled(rng, tiles, centres, words, noise, invert)


def errors(found, truth, within=1.5):
    """Return the index of the true target of each one found (-1: none), and the errors (n, 2) and covariances of
    those."""
    apart = np.linalg.norm(found.centre_px[:, None] - truth[None], axis=-1)
    match = np.where(apart.min(1) < within, apart.argmin(1), -1)
    good = match >= 0
    return match, found.centre_px[good] - truth[match[good]], found.cov_px2[good]
