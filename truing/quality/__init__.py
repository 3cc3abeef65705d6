"""Arrays that the quality checks look at: bodies over all poses, and readings under load."""
