"""tools/mutants: what is changed, that a missing test is told from one that notices, and that no file is touched."""

import tomllib
from pathlib import Path

from click.testing import CliRunner

from friction_hil.errors import FrictionHilError
from tools.mutation import command as tool
from tools.mutation.changes import changes_of, codes_of
from tools.mutation.modules import MODULES, name_of, related_tests

SOURCE = '''"""A module."""

LIMIT_S = 2.0
_names = [1]


class Axis:
    """An axis."""

    def is_late(self, time_s: float) -> bool:
        """Return True if it is late by 3 s."""
        if time_s > LIMIT_S and not self.stops:
            raise ValueError(f"late by {time_s + 1}")
        return self.found(time_s)


@compiled
def kernel(x):
    return x > 1


def count(values: list[int]) -> int:
    number = 0
    for each in values:
        number += abs(each) == 4
    return number


def wait(now_ns: int) -> None:
    next_ns = 0
    for one, other in zip([now_ns], [100], strict=True):
        next_ns = one if now_ns > next_ns else other
'''


def test_comparisons_conditions_constants_and_returns_are_changed_and_nothing_else() -> None:
    assert changes_of("x = 1") == changes_of("def f():\n    return None") == []
    assert [change.identity for change in changes_of(SOURCE)] == [
        "LIMIT_S: LIMIT_S = 2.0 -> LIMIT_S = 4.0",
        "Axis.is_late: if time_s > LIMIT_S and (not self.stops): -> if time_s > LIMIT_S or not self.stops:",
        "Axis.is_late: if time_s > LIMIT_S and (not self.stops): -> if time_s < LIMIT_S and (not self.stops):",
        "Axis.is_late: if time_s > LIMIT_S and (not self.stops): -> if time_s > LIMIT_S and self.stops:",
        "Axis.is_late: return self.found(time_s) -> return not self.found(time_s)",
        "count: number = 0 -> number = 1",
        "count: number += abs(each) == 4 -> number += abs(each) != 4",
        "count: number += abs(each) == 4 -> number += each == 4",
        "count: number += abs(each) == 4 -> number += abs(each) == 5",
        "count: return number -> return 0",
        "wait: for one, other in zip([now_ns], [100], strict=True): -> "
        "for one, other in zip([now_ns], [200], strict=True):",
        "wait: next_ns = one if now_ns > next_ns else other -> next_ns = one if now_ns < next_ns else other",
    ]


def test_each_change_is_one_of_its_own_and_is_known_again_when_lines_move() -> None:
    for path in list(MODULES)[:3]:
        source = Path(path).read_text()
        found = changes_of(source)
        assert all(change.before != change.after for change in found)
        moved = changes_of("# moved\n\n" + source)
        assert [change.identity for change in moved] == [change.identity for change in found]
    namespace: dict = {}
    exec(codes_of(SOURCE.replace("@compiled\n", ""), 9, "module")[-1], namespace)
    assert namespace["count"]([4, -4, 5]) == 1


def test_the_modules_their_tests_and_what_was_reviewed_are_there() -> None:
    for path in MODULES:
        assert Path(path).is_file()
        assert all(Path(each).is_file() for each in related_tests(path)), path
    known = {name_of(path): {change.identity for change in changes_of(Path(path).read_text())} for path in MODULES}
    for group in tomllib.loads(tool._REVIEWED.read_text())["harmless"]:
        assert group["reason"]
        for change in group["changes"]:
            assert change in known[group["module"]], f"{group['module']} has it no more: {change}"


def test_a_mutant_that_no_test_notices_is_printed_and_fails(monkeypatch, tmp_path) -> None:
    """Real processes, for a module of which the tests know one function, one only by half, and one not at all."""
    small, tests = tmp_path / "small.py", tmp_path / "tests/unit/test_small.py"
    known = "def known(x: int) -> bool:\n    return x == 3\n\n\n"
    half = "class Half:\n    def half(self, x: int) -> bool:\n        return x < 3\n\n\n"
    small.write_text(f"LIMIT = 3\n\n\n{known}{half}def unknown() -> bool:\n    return True\n")
    tests.parent.mkdir(parents=True)
    tests.write_text(
        "from small import LIMIT, Half, known\n\n"
        "def test_known():\n    assert known(LIMIT)\n    assert not known(4)\n\n"
        "def test_half():\n    assert Half().half(1)\n    assert not Half().half(5)\n"
    )
    texts = [small.read_text(), tests.read_text()]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(MODULES, "small.py", ("test_small",))
    result = CliRunner().invoke(tool.command, ["--only", "small.py", "--jobs", "1"], standalone_mode=False)
    assert result.exception is None, result.output
    assert result.return_value == 1
    assert result.stdout.splitlines()[:-1] == [
        "small.py:10: Half.half: return x < 3 -> return x < 4",
        "small.py:10: Half.half: return x < 3 -> return x <= 3",
        "small.py:14: unknown: return True -> return False (no test calls it)",
    ]
    assert "6 mutants in" in result.stdout
    assert "3 noticed (0 by their time)" in result.stdout
    assert [small.read_text(), tests.read_text()] == texts


def test_the_choice_is_that_of_the_seed_and_has_a_most() -> None:
    import random

    changes = {path: changes_of(Path(path).read_text()) for path in MODULES}
    one, same, other = (tool.choice(changes, random.Random(seed)) for seed in ("a", "a", "b"))
    assert one == same
    assert one != other
    assert sum(len(numbers) for _, numbers in one) == 400
    assert {path for path, _ in one} == set(MODULES)


def test_the_list_has_the_number_of_mutants_and_another_module_is_refused() -> None:
    words = ["--list", "--only", "daemon.sequence", "--sample", "60"]
    (line,) = CliRunner().invoke(tool.command, words, catch_exceptions=False).stdout.splitlines()
    assert line.endswith("friction_hil/daemon/sequence.py")
    assert int(line.split()[0]) > 40
    refused = CliRunner().invoke(tool.command, ["--only", "daemon.sequenze"]).exception
    assert isinstance(refused, FrictionHilError)
    assert "'daemon.sequence'" in str(refused)
