"""The modules whose mutants are tried, each with the tests that are meant to notice."""

_CANOPEN, _SERIAL = "drivers/friction_hil_drivers/canopen", "drivers/friction_hil_drivers/serial_line"
_LOOP = ("loop_endings", "loop_breaks", "gravity_feedforward")
_AXIS = ("canopen_axis", "canopen_axis_lost", "canopen_silence", "canopen_two_axes")
_ENDS = ("canopen_leaving", "canopen_restoration", "canopen_last_frames", "canopen_drives", "canopen_two_axes")

# path: names of the files tests/unit/test_NAME.py
MODULES: dict[str, tuple[str, ...]] = {
    "friction_hil/compensator/limiter.py": ("compensator_limiter",),
    "friction_hil/daemon/safety.py": ("safety", *_LOOP),
    "friction_hil/daemon/sequence.py": ("sequence",),
    "friction_hil/daemon/command.py": _LOOP,
    "friction_hil/daemon/run.py": ("control_changes", "follower", *_LOOP),
    "friction_hil/daemon/follow_check.py": ("follow_check",),
    "friction_hil/daemon/velocity_check.py": ("velocity_check",),
    "friction_hil/daemon/first_motion.py": ("first_motion",),
    "friction_hil/daemon/control/mailbox.py": ("control_mailbox",),
    "friction_hil/daemon/control/changes.py": ("control_changes",),
    "friction_hil/motion/catch_up.py": ("catch_up",),
    f"{_CANOPEN}/axis.py": _AXIS,
    f"{_CANOPEN}/exchange.py": ("canopen_exchange", "canopen_queue_full", *_AXIS),
    f"{_CANOPEN}/sdo_stop.py": (*_AXIS, "canopen_drives"),
    f"{_CANOPEN}/leaving.py": _ENDS,
    f"{_CANOPEN}/stopping.py": _ENDS,
    f"{_CANOPEN}/last_frames.py": _ENDS,
    f"{_CANOPEN}/journal.py": ("canopen_journal", "canopen_restoration"),
    f"{_CANOPEN}/monitor.py": _AXIS,
    f"{_CANOPEN}/watchdogs.py": ("canopen_watchdogs", "canopen_watchdog_times"),
    f"{_CANOPEN}/watchdog_times.py": ("canopen_watchdogs", "canopen_watchdog_times"),
    f"{_SERIAL}/scheduler.py": ("serial_scheduler", "serial_stalls", "serial_waiting", "serial_line"),
    f"{_SERIAL}/line_state.py": ("serial_line_state", "serial_scheduler"),
    f"{_SERIAL}/stopping.py": ("serial_stop", "serial_watchdog_read_back"),
    f"{_SERIAL}/axis.py": ("serial_axis",),
    "drivers/friction_hil_drivers/cia402/profile.py": ("cia402_profile",),
}


def name_of(path: str) -> str:
    """Return the dotted name of a module."""
    return path.removeprefix("drivers/").removesuffix(".py").replace("/", ".")


def related_tests(path: str) -> list[str]:
    """Return the files of the tests of a module."""
    return [f"tests/unit/test_{name}.py" for name in MODULES[path]]
