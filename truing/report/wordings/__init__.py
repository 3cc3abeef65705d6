"""Wordings of causes: every page, table and command takes its words from here."""
