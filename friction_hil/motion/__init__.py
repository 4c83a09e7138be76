"""What an axis shall do: set-points along a path, experiments for identification, and the controller that follows.

Pure: `trajectory` and `controller` run in the daemon's loop and in the simulated servo alike.
"""
