"""Drives that exchange lines of text over a serial line, each described in a YAML file."""

from pathlib import Path

DESCRIPTIONS = Path(__file__).parent / "descriptions"
