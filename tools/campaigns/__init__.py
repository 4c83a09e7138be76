"""Faults between the real daemon and simulated drives, judged by what was on the wire."""
