"""Which causes the data speak for: one whitened problem, a search over all candidates, and its judge."""
