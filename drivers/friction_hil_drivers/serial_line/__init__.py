"""Common parts of the drivers for serial lines: line, scheduler, description of a drive, axis."""
