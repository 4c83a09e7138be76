"""Reading and writing objects of a node: one transfer, and three that drive it."""
