"""Statement of uncertainty by kind of result, with a budget or the reason for its absence."""
