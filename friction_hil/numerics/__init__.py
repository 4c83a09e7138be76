"""Compilation of kernels, automatic differentiation, and filters without delay."""
