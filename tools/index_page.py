"""Metadata of a release that depend on where the project lives: its URLs, and README as a package index shows it.

A package index shows README without the files around it, so a relative link leads nowhere there, and a picture stays
empty. When a wheel or source archive is built in a clone, the clone's remote ``origin`` tells the project's home: links
and pictures then point to the commit that is built, at that home. Where there is none (no git, or a clone of a folder),
no address is made up: the metadata have no URLs, and the page names the files instead of linking to them. A wheel that
is built from a source archive takes over what the archive says.
"""

import re
import subprocess
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from hatchling.metadata.plugin.interface import MetadataHookInterface

_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?![a-z]+:|#)([^)#\s]+)(#[^)\s]*)?\)")
_SCP_FORM = re.compile(r"(?:[\w.-]+@)?([\w.-]+\.[\w-]+):(?!//)(.+)")  # git@host:owner/project.git
# Where the forges keep a file of a commit: to be read, and as it is (pictures).
_FORGES = {
    "gitlab": ("-/blob", "-/raw"),
    "gitea": ("src/commit", "raw/commit"),
    "forgejo": ("src/commit", "raw/commit"),
    "codeberg": ("src/commit", "raw/commit"),
}
_OTHER_FORGE = ("blob", "raw")


class IndexPage(MetadataHookInterface):
    """Hook of hatchling that sets ``readme`` and ``urls``."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Add them to the metadata of the project."""
        root = Path(self.root)
        base = home(root)
        text = (root / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": page(text, base)}
        metadata["urls"] = {} if base is None else urls(base)


def home(root: Path) -> tuple[str, str] | None:
    """Return the address of the project and the commit that is checked out; None if the clone names no address."""
    if _git(root, "rev-parse", "--show-toplevel") != str(root.resolve()):
        return None
    address, commit = address_of(_git(root, "config", "--get", "remote.origin.url")), _git(root, "rev-parse", "HEAD")
    return (address, commit) if address and commit else None


def address_of(remote: str) -> str | None:
    """Return the address for browsers of a git remote, without user and password; None for a folder or this machine.

    >>> address_of("git@git.example.org:team/project.git")
    'https://git.example.org/team/project'
    """
    scp_form = _SCP_FORM.fullmatch(remote)
    parts = urlsplit(f"ssh://{scp_form[1]}/{scp_form[2]}" if scp_form else remote)
    host, path = parts.hostname or "", parts.path.strip("/").removesuffix(".git")
    is_public = parts.scheme in ("http", "https", "ssh", "git") and re.search(r"[^.]\.[a-z]", host)
    if not is_public or not path:
        return None
    # the port of ssh is none for browsers
    port = f":{parts.port}" if parts.port and parts.scheme.startswith("http") else ""
    return f"https://{host}{port}/{path}"


def urls(base: tuple[str, str]) -> dict[str, str]:
    """Return the URLs of the project: its home and, in the commit that is built, documentation and changelog."""
    return {
        "Homepage": base[0],
        "Documentation": f"{_folders(base)[0]}/README.md",
        "Changelog": f"{_folders(base)[0]}/CHANGELOG.md",
    }


def page(text: str, base: tuple[str, str] | None) -> str:
    """Return README without relative links: with links to the project's home, or, without one, with names of files."""

    def replace(link: re.Match[str]) -> str:
        mark, label, path, anchor = link[1], link[2], link[3], link[4] or ""
        if base is not None:
            return f"{mark}[{label}]({_folders(base)[bool(mark)]}/{path}{anchor})"
        if mark:
            return f"*{label}: {path} in the source archive*"
        return path if label == path else f"{label} (`{path}`)"

    return _LINK.sub(replace, text)


def _folders(base: tuple[str, str]) -> tuple[str, str]:
    address, commit = base
    host = urlsplit(address).hostname or ""
    forms = next((forms for name, forms in _FORGES.items() if name in host), _OTHER_FORGE)
    return f"{address}/{forms[0]}/{commit}", f"{address}/{forms[1]}/{commit}"


def _git(root: Path, *words: str) -> str:
    """Return what git prints; "" where there is no git, or it has no answer."""
    try:
        done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
