"""The modules whose mutants are tried, each with the tests that are meant to notice."""

_CANOPEN, _SERIAL = "drivers/friction_hil_drivers/canopen", "drivers/friction_hil_drivers/serial_line"

# path: its tests below tests/unit, the fastest first
MODULES: dict[str, tuple[str, ...]] = {
    "friction_hil/daemon/safety.py": ("daemon/test_safety", "daemon/test_sequence"),
    "friction_hil/daemon/sequence.py": ("daemon/test_sequence", "daemon/test_requests"),
    "friction_hil/daemon/command.py": ("daemon/test_command",),
    "friction_hil/drive/stop.py": ("drive/test_stop", "canopen/test_canopen_axis_lost"),
    f"{_CANOPEN}/cycle/side_channel.py": ("canopen/test_canopen_axis_lost",),
    f"{_CANOPEN}/cycle/exchange.py": ("canopen/test_canopen_cycle",),
    f"{_CANOPEN}/cycle/listener.py": (
        "canopen/test_canopen_cycle",
        "canopen/test_passive_axis",
        "canopen/test_sidecar_exchange",
    ),
    f"{_CANOPEN}/cycle/health.py": ("canopen/test_canopen_axis", "canopen/test_canopen_axis_lost"),
    f"{_CANOPEN}/cycle/answer_set.py": ("canopen/test_canopen_axis", "canopen/test_canopen_axis_lost"),
    f"{_SERIAL}/scheduler.py": ("serial_line/test_serial_ahead", "serial_line/test_serial_scheduler"),
}


def name_of(path: str) -> str:
    """Return the dotted name of a module."""
    return path.removeprefix("drivers/").removesuffix(".py").replace("/", ".")


def related_tests(path: str) -> list[str]:
    """Return the files of the tests of a module."""
    return [f"tests/unit/{name}.py" for name in MODULES[path]]
