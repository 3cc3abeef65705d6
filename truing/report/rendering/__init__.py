"""Template of the page and its content; separate, so that no sentence depends on a style."""
