"""Simulated servo: mechanics with true friction, encoder and cascade control. Pure: no bus, no clock."""
