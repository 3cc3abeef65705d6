"""How causes are spoken of: one wording per cause, from which every page, table and command takes its words."""
