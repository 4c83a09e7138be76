"""Demanded motion of an axis: set-points along a path, experiments for identification, and a controller.

Pure: `trajectory` and `controller` run in the daemon's loop and in the simulated servo alike.
"""
