"""Chains with loops: a delta robot by a lab's own closure, and campaigns of it that share no code with truing."""
