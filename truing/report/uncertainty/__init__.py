"""The statement of uncertainty on the page: its words, its tables, its bars."""
