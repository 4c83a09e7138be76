"""Parameters that keep themselves tuned: refined from the ordinary motion of an axis, and judged by its errors."""
