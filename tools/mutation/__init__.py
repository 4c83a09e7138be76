"""Mutants of safety-critical modules: one line changed at a time, which a test has to notice."""
