"""The example in README.md is the one that runs."""

from pathlib import Path

import pytest

from tests.contract.rig import Rig

HERE = Path(__file__).parent


def test_the_example_is_that_of_the_tests() -> None:
    text = (HERE / "README.md").read_text()
    _, _, rest = text.partition("```python\n")
    example, end, _ = rest.partition("```\n")
    assert end
    assert example == (HERE / "test_own_driver.py").read_text()


@pytest.mark.parametrize("name", sorted(Rig.__abstractmethods__))
def test_every_method_of_a_rig_is_described(name: str) -> None:
    assert f"| `{name}(" in (HERE / "README.md").read_text()
