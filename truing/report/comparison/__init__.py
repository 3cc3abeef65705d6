"""The page of several runs of one machine: what has changed, trends, and verdicts side by side."""
