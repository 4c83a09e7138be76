"""Values of a YAML file are set in its text: the others, comments and line ends stay as they are."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.checked_yaml.edit import edit, with_value
from friction_hil.checked_yaml.text import parse
from friction_hil.errors import FrictionHilError

STEPS = ("axes", "x", "compensation", "gain")
BLOCK = """# machine
axes:
  x:                  # the axis
    model:            # replaced
      friction: {a: 1}
      mechanics: {inertia: 1.0}  # goes with it
    # stays
    compensation:
      gain: 0.9       # factor
      fade_s: 0.5
  y: {node: 2}        # another
"""


def test_a_value_changes_and_its_comment_stays_in_its_column():
    new = with_value(with_value(BLOCK, STEPS, 1.0), ("axes", "x", "model"), "out/x.yaml")
    kept = [line for line in BLOCK.splitlines() if "friction:" not in line and "mechanics:" not in line]
    changes = {"gain: 0.9 ": "gain: 1.0 ", "model:            # replaced": "model: out/x.yaml"}
    for old, value in changes.items():
        kept = [line.replace(old, value) for line in kept]
    assert new.splitlines() == kept


@pytest.mark.parametrize(
    "text",
    [
        "axes: {x: {}}\n",
        "axes: {x: {node: 1}}\n",
        "axes:\n  x:\n",
        "axes:\n  x: null # none\n",
        "axes:\r\n  x:\r\n    node: 1 # first\r\n# end\r\n",
        "axes:\n  x:\n    text: |\n      some\n      more\nbus: 1\n",
        "axes:\n  x:\n    compensation: {\n      fade_s: 1, # time\n    }\n",
        "axes:\n  x:\n    node: 1",
        BLOCK,
    ],
)
@given(gain=st.floats(0.0, 1.5))
def test_exactly_one_value_is_another(text, gain):
    wanted = parse(text, "").value
    axis = wanted["axes"]["x"] = wanted["axes"]["x"] or {}
    axis["compensation"] = {**axis.get("compensation", {}), "gain": gain}
    new = with_value(text, STEPS, gain)
    assert parse(new, "").value == wanted
    comments = [line.partition("#")[2] for line in text.splitlines() if "#" in line]
    assert [line.partition("#")[2] for line in new.splitlines() if "#" in line] == comments
    assert ("\r\n" in new) == ("\r\n" in text)


@pytest.mark.parametrize(
    "text",
    [
        "base: &base {gain: 0.5}\naxes: {x: {compensation: *base}, y: {compensation: *base}}\n",
        "axes: {x: {compensation: &shared {gain: 0.5}}, y: {compensation: *shared}}\n",
    ],
)
def test_what_would_change_more_is_refused(text):
    with pytest.raises(FrictionHilError, match=r"axes\.x\.compensation\.gain: "):
        with_value(text, STEPS, 1.0)


def test_a_file_keeps_its_mark_its_link_and_its_permissions(tmp_path):
    file, link = tmp_path / "m.yaml", tmp_path / "link.yaml"
    file.write_bytes(b"\xef\xbb\xbfaxes: {x: {compensation: {gain: 0.5}}}\n")
    file.chmod(0o640)
    link.symlink_to(file)
    edit(link, {STEPS: 0.75})
    assert file.read_bytes() == b"\xef\xbb\xbfaxes: {x: {compensation: {gain: 0.75}}}\n"
    assert (link.is_symlink(), file.stat().st_mode & 0o777) == (True, 0o640)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.yaml", "m.yaml"]
