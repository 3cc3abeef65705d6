"""The parts of the stage diagnose: what is compared, what was decided, what to measure next."""
