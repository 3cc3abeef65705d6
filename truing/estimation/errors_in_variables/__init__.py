"""Implicit models in which everything measured carries an error."""
