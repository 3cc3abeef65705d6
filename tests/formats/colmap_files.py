"""A small COLMAP model in bytes."""

from __future__ import annotations

import struct


def binary():
    """Cameras, images and points of a model, by the names of their files."""
    cameras = struct.pack("<Q", 2)
    cameras += struct.pack("<IiQQ8d", 1, 4, 4000, 3000, 4010.0, 4000.0, 2005.0, 1497.0, -0.1, 0.02, 0.0003, -0.0004)
    cameras += struct.pack("<IiQQ4d", 7, 2, 640, 480, 500.0, 320.0, 240.0, 0.05)
    images = struct.pack("<Q", 3)
    rays = {2: [(100.5, 200.5, 11), (300.0, 400.0, -1)], 3: [], 5: [(7.25, 8.25, 11)]}
    for number, camera, name in ((2, 1, b"left view.jpg"), (3, 7, b"right.jpg"), (5, 7, b"last.jpg")):
        images += struct.pack("<I7dI", number, 1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 3.0, camera) + name + b"\0"
        images += struct.pack("<Q", len(rays[number])) + b"".join(struct.pack("<2dq", *ray) for ray in rays[number])
    points = struct.pack("<QQ3d3BdQ4I", 1, 11, 1.5, -2.5, 3.5, 10, 20, 30, 0.7, 2, 2, 0, 5, 0)
    return {"cameras": cameras, "images": images, "points3D": points}
