"""Ctrl-C wherever the main thread happens to be: exit status 130 and no traceback."""

import subprocess
import sys

import pytest

# LLVM hands over each compiled function in a callback from C, from which no exception comes back
COMPILE = """
import signal, sys
import numba
from numba.core.codegen import JITCodeLibrary

original = JITCodeLibrary._object_compiled_hook.__func__

def interrupted_hook(cls, ll_module, buffer):
    signal.raise_signal(signal.SIGINT)
    original(cls, ll_module, buffer)

JITCodeLibrary._object_compiled_hook = classmethod(interrupted_hook)

def work():
    numba.njit(lambda x: x + 1.0)(1.0)
    while True:
        pass
"""
FINALISER = """
import signal

class Finalised:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def work():
    Finalised()
    while True:
        pass
"""
CALLBACK = """
import signal, weakref

class Referred:
    pass

def work():
    one = Referred()
    reference = weakref.ref(one, lambda _: signal.raise_signal(signal.SIGINT))
    del one
    while True:
        pass
"""
COMMAND = """
import sys
import click
from friction_hil.cli import exit_status

command = click.command()(work)
sys.exit(exit_status(command, [], "test"))
"""


@pytest.mark.parametrize("code", [COMPILE, FINALISER, CALLBACK], ids=["compiling", "finaliser", "callback"])
def test_an_interrupt_where_exceptions_are_lost_comes_a_little_later(code):
    words = [sys.executable, "-c", code + COMMAND]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr.strip()) == (130, "", "")


@pytest.mark.parametrize("failing", ["return", "raise FrictionHilError('a fault')"])
def test_an_interrupt_after_the_work_leaves_the_result_as_it_is(failing):
    code = f"""
import atexit, signal
from friction_hil.errors import FrictionHilError

def work():
    atexit.register(signal.raise_signal, signal.SIGINT)
    {failing}
{COMMAND.replace("[]", "None")}"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    expected = (0, "") if failing == "return" else (1, "Error: a fault")
    assert (done.returncode, done.stderr.strip()) == expected
