"""The parts of the stage calibrate: question, fits, choice, what can be known, accuracy."""
