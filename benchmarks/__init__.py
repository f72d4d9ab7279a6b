"""The table of ratios against other ways of computing the same: `python -m benchmarks`."""
