"""Page that compares runs of one machine: changes, trends, and verdicts side by side."""
