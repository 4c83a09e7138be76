"""Codes of the fault messages of all drives on serial lines, and their remedies; drivers/README.md has the causes."""

LINE_NOT_OPENED = "FH-250"
RS485_NOT_SUPPORTED = "FH-251"
LINE_LOST = "FH-252"
NO_REPLY = "FH-253"
STATE_UNKNOWN = "FH-254"
ALREADY_POWERED = "FH-255"
SETUP_REFUSED = "FH-256"
SETUP_WITHOUT_EFFECT = "FH-257"
PACE_NOT_ANSWERED = "FH-258"
STATE_NOT_REPORTED = "FH-260"
COMMANDS_REFUSED = "FH-261"
SEQUENCE_STUCK = "FH-262"
WATCHDOG_NOT_HELD = "FH-263"

TITLES = {
    LINE_NOT_OPENED: "The line does not open",
    RS485_NOT_SUPPORTED: "The port cannot switch the direction of an RS-485 line",
    LINE_LOST: "The line is gone",
    NO_REPLY: "A drive does not reply while it is being set up",
    STATE_UNKNOWN: "The drive reports a state that its description does not list",
    ALREADY_POWERED: "The drive is powered before the daemon enabled it",
    SETUP_REFUSED: "The drive refuses its set-up",
    SETUP_WITHOUT_EFFECT: "A step of the set-up has no effect",
    PACE_NOT_ANSWERED: "Drives do not answer in simulated time",
    STATE_NOT_REPORTED: "The drive does not report its state any more",
    COMMANDS_REFUSED: "The drive refuses the daemon's commands",
    SEQUENCE_STUCK: "The drive does not follow a sequence of its description",
    WATCHDOG_NOT_HELD: "The drive does not hold the watchdog that was written to it",
}

REMEDIES = {
    LINE_NOT_OPENED: "the remedy in the message; `friction-hil doctor FILE`",
    RS485_NOT_SUPPORTED: "`is_rs485: false` if the adapter switches by itself",
    LINE_LOST: "check cable, adapter and gateway; the drive's own watchdog ends its torque",
    NO_REPLY: "correct `line` and the address; check termination and wires",
    STATE_UNKNOWN: "add the state to `states` of the description",
    ALREADY_POWERED: "`friction-hil stop CONFIG`, once no other master runs",
    SETUP_REFUSED: "the drive's manual; `prepare` of the description",
    SETUP_WITHOUT_EFFECT: "`timeout_s` and the steps of the description",
    PACE_NOT_ANSWERED: "start `friction-hil simulate FILE --pace sync`",
    STATE_NOT_REPORTED: "the reason at the end of the message; check the line",
    COMMANDS_REFUSED: "the drive's words in the message; its mode and limits",
    SEQUENCE_STUCK: (
        "the error that the drive reports; `enable`, `disable`, `quick_stop` and `reset_fault` of the description"
    ),
    WATCHDOG_NOT_HELD: "another `watchdog_s`; `watchdog` and its signals in the description",
}
