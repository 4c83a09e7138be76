"""Codes of the fault messages of all drives on serial lines, each with its message, cause and remedy."""

from friction_hil.drive.codes import Explanation

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

EXPLANATIONS = {
    LINE_NOT_OPENED: Explanation(
        "... cannot be opened; no connection",
        "no such port, no permission, another process has it; the drive is off or does not accept connections",
        "the remedy in the message; `friction-hil doctor FILE`",
    ),
    RS485_NOT_SUPPORTED: Explanation(
        "... cannot switch the direction of an RS-485 line",
        "the adapter or its kernel driver does not support it",
        "`is_rs485: false` if the adapter switches by itself",
    ),
    LINE_LOST: Explanation(
        "the adapter was unplugged; the peer closed the connection",
        "cable, adapter or gateway",
        "check cable, adapter and gateway; the drive's own watchdog ends its torque",
    ),
    NO_REPLY: Explanation(
        "...: no reply (... attempts); or the bytes that came, and what a valid reply looks like",
        "wrong address, port, baud rate or parity; wires swapped; drive off",
        "correct `line` and the address; check termination and wires",
    ),
    STATE_UNKNOWN: Explanation(
        "the drive reports a state that its description does not list",
        "a state or mask is missing in the description",
        "add the state to `states` of the description",
    ),
    ALREADY_POWERED: Explanation(
        "the drive is in state ... already",
        "another master drives it, or an earlier one ended without disabling it",
        "`friction-hil stop CONFIG`, once no other master runs",
    ),
    SETUP_REFUSED: Explanation(
        "the drive refuses its set-up; ... was followed by what is no reply",
        ("a value that it does not accept, an access level, a lock; an error line that the description does not list"),
        "the drive's manual; `prepare` of the description",
    ),
    SETUP_WITHOUT_EFFECT: Explanation(
        "... should lead to ... within ... s",
        "the drive needs longer, or another step first",
        "`timeout_s` and the steps of the description",
    ),
    PACE_NOT_ANSWERED: Explanation(
        "not every drive has answered",
        "simulated drives ended or were never started",
        "start `friction-hil simulate FILE --pace sync`",
    ),
    STATE_NOT_REPORTED: Explanation(
        "the drive has not reported its state for more than ... s",
        "replies are lost or refused",
        "the reason at the end of the message; check the line",
    ),
    COMMANDS_REFUSED: Explanation(
        "the drive refuses its commands",
        "ten set-points in a row were refused",
        "the drive's words in the message; its mode and limits",
    ),
    SEQUENCE_STUCK: Explanation(
        "the drive does not follow: ... should lead to ... within ... s",
        "the drive stays in another state than its description expects",
        "the error that the drive reports; `enable`, `disable`, `quick_stop` and `reset_fault` of the description",
    ),
    WATCHDOG_NOT_HELD: Explanation(
        "the drive does not hold its watchdog: ... was written, ... is read back",
        "the drive refused the value, or counts the time in steps of its own",
        "another `watchdog_s`; `watchdog` and its signals in the description",
    ),
}

REMEDIES = {code: each.remedy for code, each in EXPLANATIONS.items()}
