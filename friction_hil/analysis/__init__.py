"""Analysis of recorded motion: following error and circularity."""
