"""Parts of the stage calibrate: problem, fits, choice, observability, accuracy."""
