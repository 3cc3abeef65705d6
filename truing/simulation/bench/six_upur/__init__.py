"""A six-axis force sensor on six elastic legs (6-UPUR): what loads and tolerances do to it. Knows no data."""
