"""Simulated servo: mechanics with true friction, encoder and cascade control, without bus or clock."""
