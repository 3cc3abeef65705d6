"""What quality checks look at: bodies over all poses, and readings under load, as arrays."""
