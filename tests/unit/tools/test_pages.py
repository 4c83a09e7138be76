"""The project's pages: links lead somewhere, files that are named exist, the map of the rooms is complete."""

import re
import tomllib
from pathlib import Path

import pytest

from friction_hil import __version__

ROOT = Path(__file__).parents[3]
PAGES = sorted(
    path
    for top in ("README.md", "CHANGELOG.md", "friction_hil", "drivers", "tests", "tools", "config")
    for path in ([ROOT / top] if top.endswith(".md") else (ROOT / top).rglob("*.md"))
)
LINES = {ROOT / "README.md": 120, ROOT / "CHANGELOG.md": 40}  # of what is not released yet
OVERVIEW = ROOT / "friction_hil/README.md"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file_and_a_page_is_no_book(page: Path) -> None:
    text = page.read_text()
    for path, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([^)]*))?\)", text):
        target = page.parent / path if path else page
        assert target.exists(), path
        assert not anchor or anchor in anchors(target), f"{path}#{anchor}"
    if page.name == "CHANGELOG.md":
        text = text.partition("## Unreleased\n")[2].partition("\n## ")[0]
    assert len(text.encode()) <= 12_000
    assert len(text.splitlines()) <= LINES.get(page, 1000)


def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as the forges make them."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_changelog_begins_with_the_version_of_the_package() -> None:
    headings = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    released = [heading for heading in headings if heading != "Unreleased"]
    assert all(re.fullmatch(r"\d+\.\d+\.\d+ - \d{4}-\d\d-\d\d", heading) for heading in released)
    versions = [tuple(map(int, heading.split(" ")[0].split("."))) for heading in released]
    assert versions == sorted(set(versions), reverse=True)
    release, is_development, _ = __version__.partition(".dev")
    own = tuple(map(int, release.split(".")))
    if is_development:
        assert headings[0] == "Unreleased"
        assert own > versions[0]
    else:
        assert headings[0].startswith(f"{release} - ")


def test_every_file_that_the_code_overview_names_exists() -> None:
    folders = ("friction_hil", "drivers", "tests")
    files = [f"/{path.relative_to(ROOT)}" for folder in folders for path in (ROOT / folder).rglob("*.py")]
    text = OVERVIEW.read_text() + (OVERVIEW.parent / "where.md").read_text()
    named = re.findall(r"`((?:[a-z0-9_.]+/)*[a-z0-9_]+\.py)`", text)
    assert named
    ends = [name.removeprefix("drivers/.../") for name in named]
    assert [name for name in ends if not any(file.endswith(f"/{name}") for file in files)] == []


def test_the_map_has_every_room_in_the_order_of_the_layers() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    rows = re.findall(
        r"^\| ((?:`[a-z_.]+`(?: · )?)+) \|", OVERVIEW.read_text().partition("## The rooms")[2], re.MULTILINE
    )
    shown = [" | ".join(sorted(re.findall(r"`([a-z_]+)(?:\.py)?`", row))) for row in rows][: len(layers)]
    assert shown == [" | ".join(sorted(layer.split(" | "))) for layer in layers]
