"""The statement of uncertainty, by kind of result: each module states results with a budget, or says why it cannot."""
