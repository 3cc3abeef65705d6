"""Rigid motions between corresponding points: closed form, robust, by likelihood, of all poses at once."""
