"""Error classes of a force sensor, one sentence each; formulas: docs/error-classes.md."""

ERROR_CLASSES = {
    "nonlinearity": "Largest deviation of the mean rising readings from the best line through zero, over the range.",
    "interpolation": "Largest deviation of the mean rising readings from the best cubic through zero, over the load.",
    "hysteresis": "Largest difference of mean readings between falling and rising load, over the range.",
    "repeatability": "Largest difference of rising readings between two cycles at one load, over the range.",
    "zero return": "Largest difference between the last and the first unloaded reading of a cycle, over the range.",
    "creep": "Change of the reading under constant load between two times, over the range.",
    "crosstalk": "Largest reading of another component at the ends of the load, over the range of that component.",
}
