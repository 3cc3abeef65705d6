"""Whether the tables of a campaign belong together, and which slip of the hand explains them where they do not."""
