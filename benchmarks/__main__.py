"""All benchmarks one after the other: python -m benchmarks."""

from __future__ import annotations

import pkgutil
import runpy
import sys

import benchmarks

_SHARED = (
    "__main__",
    "blind_figures",
    "blind_instruments",
    "blind_page",
    "bundle_peers",
    "bundle_problem",
    "chains_peers",
    "errors_in_variables_peers",
    "errors_in_variables_problem",
    "pose_peers",
    "power_agreement_page",
    "timing",
)

for module in pkgutil.iter_modules(benchmarks.__path__):
    if module.name not in _SHARED:
        print(f"\n=== {module.name} ===", flush=True)
        sys.argv = [module.name]
        runpy.run_module(f"benchmarks.{module.name}", run_name="__main__")
