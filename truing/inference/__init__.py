"""Decide which causes the data support: one whitened linear problem, a search over all candidates, its null
distribution.

An epoch is one row in time, with local unknowns. A channel is a quantity of dimension d that is measured at each epoch.
A group is a set of channels that share an error. Inputs are values that are read or set, with errors of their own. A
pathway is a way by which causes act on observations.
"""
