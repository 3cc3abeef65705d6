"""Loads and channels as a reader has them: their order, their symbols, handy units."""

from __future__ import annotations

LOADS = ("fx", "fy", "fz", "mx", "my", "mz")
CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")
ARCSECOND = 4.84813681109536e-06  # rad


def load_unit(load: str) -> str:
    """The unit that a load is applied in."""
    return "N" if load.startswith("f") else "N·m"


def moved_unit(channel: str) -> str:
    """The unit that a channel is read in."""
    return "µm" if channel.startswith("d") else "arcsec"


def kilo(load: str) -> str:
    """A thousand of a load's unit."""
    return f"k{load_unit(load)}"


def per_kilo(channel: str, load: str) -> tuple[float, str]:
    """What turns an entry of the compliance from SI into something with few digits, and its unit."""
    factor = 1e9 if channel.startswith("d") else 1e3 / ARCSECOND
    return factor, f"{moved_unit(channel)}/{kilo(load) if load.startswith('f') else '(kN·m)'}"
