"""truing: diagnose where a mechanism and its simulation part ways, from measured points and readings."""

from __future__ import annotations

__version__ = "0.1.0"
