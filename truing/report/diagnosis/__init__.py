"""Section of the diagnosis, and sentences on findings."""
