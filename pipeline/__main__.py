"""`python -m pipeline` is `truing`."""

from __future__ import annotations

from pipeline.command_line import main

main()
