"""One module per stage, in the order of the data flow; each converts tables to tables."""
