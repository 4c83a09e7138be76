"""Files by which a system tells about itself, laid out by a test."""

from pathlib import Path


def lay(root: Path, **files: str) -> Path:
    """Write files below ``root``; ``__`` in a name stands for a slash."""
    for name, text in files.items():
        path = root / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root
