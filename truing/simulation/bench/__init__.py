"""A loaded sensor on its bench: what is known of it, how loads become readings, and its extended model."""
