"""The documentation as a site, and the check of a release."""

import re
import subprocess

import pytest

from friction_hil import __version__
from friction_hil.doctor.explanations import explanations
from tests.readme_commands import ROOT

pytestmark = pytest.mark.deep


def test_the_site_is_built_without_a_warning_and_has_every_page_and_message():
    done = subprocess.run([ROOT / "tools/docs"], capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    site = ROOT / "out/site"
    for page in ("README", "CHANGELOG", "tools/site/first_axis", "friction_hil/daemon/README", "drivers/serial_drives"):
        assert "</html>" in (site / f"{page}.html").read_text()
    messages = (site / "out/generated/messages.html").read_text()
    assert set(re.findall(r"<p>(FH-\d{3})</p>", messages)) == set(explanations())
    assert "friction_hil.models.create" in (site / "out/generated/api.html").read_text()


@pytest.mark.skipif(".dev" not in __version__, reason="this is a release")
def test_a_development_version_is_not_released():
    done = subprocess.run([ROOT / "tools/release"], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 1
    assert f"version {__version__} in friction_hil/__init__.py is none of a release" in done.stderr
    assert done.stdout == ""
