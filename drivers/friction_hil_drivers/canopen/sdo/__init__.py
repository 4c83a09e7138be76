"""Reading and writing objects of a node: one transfer, and two that drive it."""
