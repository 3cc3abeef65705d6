"""What measurements can tell before any is taken, and where to measure."""
