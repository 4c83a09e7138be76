"""Servos that speak Dynamixel Protocol 2.0, each described by its control table in a YAML file."""
