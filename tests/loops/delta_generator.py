"""Campaigns of a delta robot with hidden errors; closed-form kinematics, no code of truing.

The platform stays level: its centre is where three spheres meet, about each elbow less the place of the ball.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arms.transforms import lower_meeting

ANGLES = np.radians([0.0, 120.0, 240.0])
TARGETS = np.array([[0.05, 0.0, -0.02], [-0.04, 0.04, -0.01], [-0.03, -0.05, 0.0], [0.02, 0.03, 0.03]])


@dataclass(frozen=True)
class Delta:
    """Sizes in m; errors of each arm's zero (3,) rad, forearm length (3,) m, and its growth (3,) 1/K."""

    base: float = 0.20
    arm: float = 0.25
    forearm: float = 0.55
    platform: float = 0.06
    zeros: NDArray = field(default_factory=lambda: np.zeros(3))
    longer: NDArray = field(default_factory=lambda: np.zeros(3))
    growth: NDArray = field(default_factory=lambda: np.zeros(3))

    def centres(self, q: NDArray, heat: NDArray) -> NDArray:
        """Return the platform's centre (B, 3), m, at arm angles (B, 3), rad, positive downwards, and heat (B,) K."""
        turned = q + self.zeros
        out = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0.0 * ANGLES], -1)
        reach = self.base + self.arm * np.cos(turned) - self.platform
        about = reach[..., None] * out - (self.arm * np.sin(turned))[..., None] * np.array([0.0, 0.0, 1.0])
        radius = (self.forearm + self.longer) * (1.0 + self.growth * heat[:, None])
        return lower_meeting(about, radius)


def urdf(delta: Delta) -> str:
    """Return the nominal robot: arms, forearms that hang from the elbows, and a platform on three slides."""
    height = np.sqrt(delta.forearm**2 - (delta.base + delta.arm - delta.platform) ** 2)
    joints = []
    for k, angle in enumerate(ANGLES, 1):
        place = delta.base * np.array([np.cos(angle), np.sin(angle), 0.0])
        ball = delta.platform * np.array([np.cos(angle), np.sin(angle), 0.0])
        joints += [
            _joint(f"arm_{k}", "base_link", f"upper_arm_{k}", place, "revolute", "0 1 0", angle),
            _joint(f"elbow_{k}", f"upper_arm_{k}", f"forearm_{k}", np.array([delta.arm, 0.0, 0.0])),
            _joint(f"length_{k}", f"forearm_{k}", f"forearm_end_{k}", np.array([0.0, 0.0, -delta.forearm])),
            _joint(f"seat_{k}", "platform", f"ball_{k}", ball),
        ]
    low = np.array([0.0, 0.0, -height])
    joints += [
        _joint("platform_x", "base_link", "slide_x", low, "prismatic", "1 0 0"),
        _joint("platform_y", "slide_x", "slide_y", 0.0 * low, "prismatic", "0 1 0"),
        _joint("platform_z", "slide_y", "platform", 0.0 * low, "prismatic", "0 0 1"),
    ]
    links = ["base_link", *(joint.split('child link="')[1].split('"')[0] for joint in joints)]
    body = "\n".join([*(f'  <link name="{link}"/>' for link in links), *joints])
    return f'<robot name="delta">\n{body}\n</robot>\n'


def _joint(
    name: str, parent: str, child: str, xyz: NDArray, kind: str = "fixed", axis: str = "1 0 0", yaw: float = 0.0
) -> str:
    limit = '<limit lower="-1" upper="1.2" effort="1" velocity="1"/>' if kind != "fixed" else ""
    at = " ".join(f"{value:.17g}" for value in xyz)
    return (
        f'  <joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}" rpy="0 0 {yaw:.17g}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


@dataclass(frozen=True)
class Hidden:
    """Hidden effect: backlash (3,), rad, of the arms next to the errors of the true robot."""

    robot: Delta
    backlash: NDArray = field(default_factory=lambda: np.zeros(3))


def write(folder: Path, hidden: Hidden, rng: np.random.Generator, poses: int = 80, tolerance: str = "") -> Path:
    """Write a campaign: targets of the platform measured by an instrument that stands still, 10 µm noise."""
    folder.mkdir(parents=True)
    q = rng.uniform(-0.5, 0.9, (poses, 3))
    heat = 3.0 * np.sin(np.linspace(0.0, 7.0, poses)) + rng.normal(0.0, 0.3, poses)
    way = np.sign(np.diff(q, axis=0, prepend=q[:1] - 1.0))
    centre = hidden.robot.centres(q - hidden.backlash * way, heat)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    seen = (centre[:, None] + TARGETS) @ turn.T + np.array([1.0, 0.4, 0.8])
    seen += rng.normal(0.0, 1e-5, seen.shape)
    (folder / "delta.urdf").write_text(urdf(Delta()), encoding="utf-8")
    (folder / "campaign.toml").write_text(_TOML.format(tolerance=tolerance), encoding="utf-8")
    rows = ["pose,role,time_s,temperature_c,arm_1_deg,arm_2_deg,arm_3_deg"]
    for n, degree in enumerate(np.degrees(q)):
        role = "verification" if n % 5 == 4 else "calibration"
        rows.append(f"{n + 1},{role},{60 * n},{20 + heat[n]:.4f}," + ",".join(f"{value:.7f}" for value in degree))
    (folder / "configurations.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    lines = ["pose,body,target,x_mm,y_mm,z_mm"]
    for n, points in enumerate(seen * 1e3):
        lines += [f"{n + 1},platform,P{k + 1},{x:.5f},{y:.5f},{z:.5f}" for k, (x, y, z) in enumerate(points)]
    (folder / "points.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    survey = [f"platform,P{k + 1},{x * 1e3:.5f},{y * 1e3:.5f},{z * 1e3:.5f}" for k, (x, y, z) in enumerate(TARGETS)]
    (folder / "targets.csv").write_text("\n".join(["body,target,x_mm,y_mm,z_mm", *survey]) + "\n", encoding="utf-8")
    return folder


_TOML = """[campaign]
name = "delta"
kind = "photogrammetry"

[mechanism]
type = "chain"
urdf = "delta.urdf"
closure = "delta"
base = "base_link"
tip = "platform"
joints = ["arm_1", "arm_2", "arm_3"]
reference_temperature_c = 20.0
{tolerance}
[measurement]
frame = "campaign"

[noise]
point_mm = 0.01
"""
