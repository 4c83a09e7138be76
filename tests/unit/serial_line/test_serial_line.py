"""Serial ports as they are opened; pseudo-terminals stand for them."""

import os
import pty
import termios
import time
import tty

import pytest
from friction_hil_drivers.serial_line.line import Line, LineGoneError
from friction_hil_drivers.serial_line.options import LineOptions

from friction_hil.errors import BusError

COARSE_CLOCK = 5  # Linux's CLOCK_REALTIME_COARSE, which gives files their times


@pytest.fixture
def terminal():
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    yield os.ttyname(theirs)
    os.close(theirs)
    os.close(ours)


@pytest.mark.parametrize("parity", ["none", "even", "odd"])
@pytest.mark.parametrize("stop_bits", [1, 2])
@pytest.mark.parametrize("baud", [300, 115200, 123456])
def test_a_pseudo_terminal_can_be_opened_again_whatever_its_settings(terminal, parity, stop_bits, baud):
    """It knows no parity, and refuses to be given one the second time: a simulated drive serves several runs."""
    options = {"port": terminal, "parity": parity, "stop_bits": stop_bits, "baud": baud}
    for _ in range(3):
        line = Line(LineOptions.model_validate(options))
        line.open()
        assert line.is_open
        line.close()


def test_a_port_whose_settings_are_refused_is_told(terminal, monkeypatch):
    """pyserial lets this error of the operating system through, which is no OSError."""

    def refuse(*_):
        raise termios.error(22, "Invalid argument")

    monkeypatch.setattr(termios, "tcsetattr", refuse)
    with pytest.raises(BusError, match=r"cannot be opened: .*Invalid argument"):
        Line(LineOptions.model_validate({"port": terminal})).open()


def test_the_link_of_a_drive_that_died_leads_to_nobody(tmp_path):
    """The number of its pseudo-terminal is given to the next one who asks for any: a terminal window, another drive."""
    link = tmp_path / "line"

    def attached():
        ours, theirs = pty.openpty()
        tty.setraw(ours)
        return ours, theirs, os.ttyname(theirs)

    ours, theirs, name = attached()
    link.symlink_to(name)
    line = Line(LineOptions.model_validate({"port": str(link)}))
    line.open()
    made_ns = os.stat(name).st_ctime_ns
    line.close()  # as an adapter that hangs: the terminal is still the same
    assert line.reopen()
    os.close(theirs)
    os.close(ours)
    with pytest.raises(LineGoneError):
        line.read()
    while time.clock_gettime_ns(COARSE_CLOCK) <= made_ns:
        pass  # the file system tells the times of two terminals apart no sooner

    others = [attached() for _ in range(8)]  # one of them is given the number, unless another process was faster
    assert not line.reopen()

    link.unlink()
    link.symlink_to(others[0][2])
    assert line.reopen()
    line.close()
    for ours, theirs, _ in others:
        os.close(theirs)
        os.close(ours)
