"""Frames on a bus: identifiers of CiA 301, the ways to send and receive them, and who else uses the bus."""
