"""Replay of recordings: through friction models, and through the daemon's own compensator."""
