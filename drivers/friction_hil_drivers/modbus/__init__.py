"""Drives with Modbus RTU or TCP, described by their register map."""
