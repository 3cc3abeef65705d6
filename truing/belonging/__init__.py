"""Consistency of a campaign's tables with each other, and recording mistakes (slips) that explain contradictions."""
