"""What the data can know of the parameters, and what swallows what."""
