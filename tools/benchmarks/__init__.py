"""Benchmarks: one module or package each, with a function ``run`` that returns the rows of the result."""
