"""Rigid motions between corresponding points: closed form, robust, by likelihood, for all poses at once."""
