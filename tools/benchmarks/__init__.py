"""Benchmarks: one module each, under its name, with a function ``run`` that returns the rows of the result."""
