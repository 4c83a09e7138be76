"""What happens in each cycle with drives that the daemon moves, or only listens to."""
