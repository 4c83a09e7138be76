"""The project's page on a package index: README without links that lead nowhere there."""

import re
import subprocess
from pathlib import Path

import pytest

from tools.index_page import address_of, home, page, urls

ROOT = Path(__file__).parents[3]
README = (ROOT / "README.md").read_text(encoding="utf-8")
TARGETS = re.compile(r"\]\(([^)]+)\)")
COMMIT = "0123456789abcdef0123456789abcdef01234567"


@pytest.mark.parametrize(
    ("remote", "address"),
    [
        ("https://git.example.org/team/project.git", "https://git.example.org/team/project"),
        ("https://git.example.org/team/project", "https://git.example.org/team/project"),
        ("http://git.example.org:8443/team/project/", "https://git.example.org:8443/team/project"),
        ("https://user:secret@git.example.org/team/project.git", "https://git.example.org/team/project"),
        ("git@git.example.org:team/project.git", "https://git.example.org/team/project"),
        ("ssh://git@git.example.org:2222/team/project.git", "https://git.example.org/team/project"),
        ("/srv/git/project.git", None),
        ("../project", None),
        ("file:///srv/git/project.git", None),
        ("http://localhost/project.git", None),
        ("https://127.0.0.1/team/project.git", None),
        ("https://git.example.org/", None),
        ("", None),
    ],
)
def test_address_of_a_remote(remote, address):
    assert address_of(remote) == address


@pytest.mark.parametrize(
    ("host", "text", "picture"),
    [
        ("git.example.org", "blob", "raw"),
        ("gitlab.example.org", "-/blob", "-/raw"),
        ("gitea.example.org", "src/commit", "raw/commit"),
    ],
)
def test_links_and_pictures_point_to_the_commit_at_the_home(host, text, picture):
    base = f"https://{host}/team/project"
    shown = page("![curve](a/b.png) and [page](c/README.md#part)", (base, COMMIT))
    assert shown == f"![curve]({base}/{picture}/{COMMIT}/a/b.png) and [page]({base}/{text}/{COMMIT}/c/README.md#part)"
    assert urls((base, COMMIT))["Changelog"] == f"{base}/{text}/{COMMIT}/CHANGELOG.md"


def test_readme_has_absolute_links_to_files_that_there_are_and_without_a_home_none_that_leads_nowhere():
    base = "https://git.example.org/team/project"
    targets = TARGETS.findall(page(README, (base, COMMIT)))
    assert any(target.endswith(".png") for target in targets)
    for target in targets:
        assert target.startswith(("https://", "#")), target
        if target.startswith(base):
            assert (ROOT / target.removeprefix(base).split("/", 3)[3].partition("#")[0]).is_file(), target
    shown = page(README, None)
    assert [target for target in TARGETS.findall(shown) if not target.startswith(("https://", "#"))] == []
    assert "tools/pictures/circularity.png in the source archive" in shown
    assert "![" not in shown


def test_home_is_that_of_the_clone_and_of_no_repository_around_it(tmp_path):
    def git(*words):
        subprocess.run(["git", "-C", tmp_path, "-c", "user.name=a", "-c", "user.email=a@b.c", *words], check=True)

    assert home(tmp_path) is None
    git("init", "--quiet")
    git("commit", "--quiet", "--allow-empty", "--message", "first")
    assert home(tmp_path) is None
    git("remote", "add", "origin", "https://user:secret@git.example.org/team/project.git")
    address, commit = home(tmp_path)
    assert address == "https://git.example.org/team/project"
    assert re.fullmatch(r"[0-9a-f]{40}", commit)
    inner = tmp_path / "unpacked"
    inner.mkdir()
    assert home(inner) is None
