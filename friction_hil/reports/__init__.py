"""Reports and pictures: HTML pages that need no other file, and figures."""
