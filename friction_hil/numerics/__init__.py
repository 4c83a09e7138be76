"""Compilation, automatic differentiation and filters that several rooms use."""
