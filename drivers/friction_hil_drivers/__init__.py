"""Drives for friction_hil: one package a protocol, each with its drive and its simulated drive."""
