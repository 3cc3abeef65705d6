"""What an extended model of an axis predicts."""
