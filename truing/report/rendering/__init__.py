"""How the page becomes a file: its template, and what fills it; apart, so that no sentence depends on a style."""
