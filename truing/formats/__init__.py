"""One reader per file format; nothing else touches raw files."""
