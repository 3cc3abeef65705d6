"""Parts of the stage diagnose: data, decisions, next measurements."""
