"""Number of campaigns that run at a time."""

from __future__ import annotations

import os

# Tests that run side by side already keep the cores busy; further processes would only load everything again.
AT_ONCE = 1 if "PYTEST_XDIST_WORKER" in os.environ else 2
