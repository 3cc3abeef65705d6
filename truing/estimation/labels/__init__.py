"""Which point is which target."""
