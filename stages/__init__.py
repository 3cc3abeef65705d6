"""One module per stage, in the order in which data flows; each is tables in, tables out."""
