"""Drives that another controller moves: the daemon listens, and sends a torque offset."""
