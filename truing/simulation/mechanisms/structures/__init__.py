"""Models of the structure of a mechanism: rigid legs, flexures, elastic legs."""
