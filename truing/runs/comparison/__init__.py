"""Runs of one machine side by side: which of its numbers have changed from one campaign to the next."""
