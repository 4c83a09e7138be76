"""Conversion of YAML text to values: the core schema of YAML 1.2, line numbers, and refused input."""

import math
import re

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from friction_hil.checked_yaml import text as yaml_text
from friction_hil.errors import ConfigurationError

# The table of section 10.3.2 of the YAML 1.2.2 specification.
SPECIFICATION = [
    (r"null|Null|NULL|~", lambda text: None),
    (r"", lambda text: None),
    (r"true|True|TRUE", lambda text: True),
    (r"false|False|FALSE", lambda text: False),
    (r"[-+]?[0-9]+", int),
    (r"0o[0-7]+", lambda text: int(text[2:], 8)),
    (r"0x[0-9a-fA-F]+", lambda text: int(text[2:], 16)),
    (r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", float),
    (r"[-+]?(\.inf|\.Inf|\.INF)", lambda text: float(text.replace(".", ""))),
    (r"\.nan|\.NaN|\.NAN", lambda text: math.nan),
]


def by_the_specification(text):
    for pattern, meaning in SPECIFICATION:
        if re.fullmatch(pattern, text):
            return meaning(text)
    return text


def same(one, other):
    if isinstance(one, float) and isinstance(other, float) and math.isnan(one):
        return math.isnan(other)
    return type(one) is type(other) and one == other


def value_of(text):
    return yaml_text.parse(text, "file.yaml").value


def mistakes(text):
    try:
        problems = yaml_text.parse(text, "file.yaml").problems
    except ConfigurationError as error:
        problems = error.problems
    return [(problem.line, problem.message) for problem in problems]


@pytest.mark.parametrize(
    ("text", "value"),
    [("-.5e-3", -5e-4), ("-.INF", -math.inf), ("0x10", 16), ("0o14", 12), ("~", None), ("", None), ("True", True)]
    + [(text, text) for text in ("tRUE", "on", "No", "1:30", "1_000", "0b11", "nan", "1e", "2024-01-01", "-012", "00")],
)
def test_a_scalar_in_quotes_is_a_text_whatever_it_is_without(text, value):
    assert same(value_of(f"key: {text}\n")["key"], value)
    assert value_of(f"key: '{text}'\n")["key"] == text


@given(
    st.one_of(
        st.text("0123456789+-.eExXoOabfiInNtru~:_ ", max_size=8),
        *(st.from_regex(pattern, fullmatch=True) for pattern, _ in SPECIFICATION),
    )
)
def test_every_scalar_means_what_the_specification_says(text):
    try:
        ours = yaml_text.resolve(text)
    except OverflowError:
        assert abs(float(by_the_specification(text) if len(text) < 300 else math.inf)) > 1e308
        return
    if re.fullmatch(r"[-+]?0[0-9]+", text):
        assert ours == text  # the one exception: octal to YAML 1.1, decimal to 1.2
    else:
        assert same(ours, by_the_specification(text))


ODD = ["1e3", "0o14", "012", "on", "<<", "~", "1:30", "0x1F", ".inf", "1e999", "null", ""]
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**20), 10**20) | st.floats() | st.text() | st.sampled_from(ODD),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@given(PLAIN)
@example({"\x85": ["a\u2028 ", "\ufeff", "\t", " a ", "- b", "# c", "a: b", "a #b"]})
def test_what_is_dumped_is_read_back(value):
    def equal(one, other):
        if isinstance(one, dict):
            return list(one) == list(other) and all(equal(one[key], other[key]) for key in one)
        if isinstance(one, list):
            return len(one) == len(other) and all(map(equal, one, other))
        return same(one, other)

    assert equal(value, value_of(yaml_text.dump(value)))


@given(PLAIN.filter(lambda value: isinstance(value, dict | list)))
def test_the_lines_are_those_of_the_parser(value):
    text = yaml.safe_dump(value, default_flow_style=False, allow_unicode=True)
    document = yaml_text.parse(text, "file.yaml")

    def compare(node, steps):
        if isinstance(node, yaml.MappingNode):
            for name, child in node.value:
                assert document.line((*steps, name.value)) == name.start_mark.line + 1
                compare(child, (*steps, name.value))
        elif isinstance(node, yaml.SequenceNode):
            for index, child in enumerate(node.value):
                assert document.line((*steps, index)) == child.start_mark.line + 1
                compare(child, (*steps, index))

    compare(yaml.compose(text, Loader=yaml.SafeLoader), ())


def test_the_line_of_what_is_not_there_is_its_parents():
    document = yaml_text.parse("a: 1\nb:\n  c: 2\n", "file.yaml")
    assert document.line(("b", "d", 3)) == 2


def test_anchors_and_merge_keys():
    text = "base: &base {a: 1, b: 2}\nother: {<<: *base, b: 3, c: *base}\nlist: {<<: [{a: 1}, {a: 2, b: 2}]}\n"
    assert value_of(text)["other"] == {"a": 1, "b": 3, "c": {"a": 1, "b": 2}}
    assert value_of(text)["list"] == {"a": 1, "b": 2}


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("a: 1\nb: 2\na: 3\n", 3, "first in line 1"),
        ("a:\n  b: 1\n  'b': 2\n", 3, "first in line 2"),
        ("a: 1\n---\nb: 2\n", 2, "a second document"),
        ("", None, "is empty"),
        ("# nothing\n", None, "is empty"),
        ("a:\n\tb: 1\n", 2, "a tab"),
        ("a: 1\n  \tb: 1\n", 2, "a tab"),
        ("a: 1\nb: !!python/object:os.system {}\n", 2, "tags"),
        ("a: !!int 3\n", 1, "tags such as !!int"),
        ("a: 1\nb: 1e999\n", 2, "too large"),
        ("a: " + "9" * 5000 + "\n", 1, "too large"),
        ("a: 0x" + "f" * 390 + "\n", 1, "too large"),
        ("a: *nowhere\n", 1, "not defined"),
        ("a: &a\n  b: *a\n", 2, "part of"),
        ("a: 1\n<<: 3\n", 2, "merge"),
        ("a: 1\n? [b]\n: 2\n", 2, "a key must be"),
        ("a: 1\nb: [1,\n", 3, "is not YAML"),
        ("a: 'b\nc: 1\n", 3, "begins in line 1"),
        ("a: b: c\n", 1, "quote"),
        ("a: 1\n b: 2\n", 2, "indentation"),
        ("a: @b\n", 1, "needs quotes"),
        ("a: 1\nb: \x00\n", 2, "U+0000"),
        ("ä: 1\nb: \x07\n", 2, "U+0007"),
        ("a: \udc80\n", 1, "invalid character"),
    ],
)
def test_mistake(text, line, message):
    [(found_line, found)] = mistakes(text)
    assert found_line == line
    assert message in found


def test_several_mistakes_are_reported_at_once():
    assert [line for line, _ in mistakes("a: 1\na: 2\nb: !x 3\nc: 1e999\n")] == [2, 3, 4]


def test_bombs_are_refused():
    doubling = "a0: &a0 [1, 1]\n" + "".join(f"a{n + 1}: &a{n + 1} [*a{n}, *a{n}]\n" for n in range(40))
    chain = "a0: &a0 [1]\n" + "".join(f"a{n + 1}: &a{n + 1} [*a{n}]\n" for n in range(100))
    merging = "a0: &a0 {x: 1}\n" + "".join(f"a{n + 1}: &a{n + 1} {{b: *a{n}, <<: *a{n}}}\n" for n in range(40))
    for text in (doubling, chain, merging, "[" * 100_000, "{a: " * 1000, "- " * 1000):
        [(line, message)] = mistakes(text)
        assert line is not None
        assert "levels" in message


@given(st.text())
def test_any_text_is_a_value_or_a_mistake(text):
    assert all(message for _, message in mistakes(text))


@pytest.mark.parametrize(
    ("data", "line", "message"),
    [
        (b"a: 1\nb: \xff\n", 2, "UTF-8"),
        ("a: 1\n".encode("utf-16"), 1, "UTF-8"),
        (b"# " + b"x" * (16 << 20), None, "larger than 16 MiB"),
    ],
)
def test_unreadable_bytes(tmp_path, data, line, message):
    path = tmp_path / "file.yaml"
    path.write_bytes(data)
    with pytest.raises(ConfigurationError, match=message) as caught:
        yaml_text.read(path)
    assert [(problem.path, problem.line) for problem in caught.value.problems] == [(str(path), line)]
    for unreadable in (tmp_path / "missing.yaml", tmp_path):
        with pytest.raises(ConfigurationError, match="cannot be read") as caught:
            yaml_text.read(unreadable)
        assert caught.value.problems[0].path == str(unreadable)


def test_a_byte_order_mark_and_windows_line_ends_do_no_harm(tmp_path):
    path = tmp_path / "file.yaml"
    path.write_bytes("\ufeffa: 1\r\nb:\r\n  c: 2\r\n".encode())
    document = yaml_text.read(path)
    assert document.value == {"a": 1, "b": {"c": 2}}
    assert document.line(("b", "c")) == 3
