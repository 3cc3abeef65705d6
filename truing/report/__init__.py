"""How results are said and shown: figures, sentences, templates. Knows tables, and nothing of how they came about."""
