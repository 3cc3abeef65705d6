"""Inference of causes from data: one whitened problem, a search over all candidates, and its null distribution.

Rows in time are *epochs*, each with local unknowns; what is measured at each is a *channel* of dimension d; channels
that share an error are a *group*; *inputs* are what is read or set, with errors of its own; a *pathway* is a way by
which causes act on observations.
"""
