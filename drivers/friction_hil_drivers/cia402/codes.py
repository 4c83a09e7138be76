"""Codes of fault messages that the objects of a drive give rise to, on whatever bus."""

from friction_hil.drive.codes import Explanation

SDO_ABORT = "FH-208"
OBJECT_MISSING = "FH-209"
OBJECT_SIZE = "FH-210"
WRONG_IDENTITY = "FH-211"
MODE_NOT_SUPPORTED = "FH-212"
UNIT_UNKNOWN = "FH-214"
ALREADY_POWERED = "FH-215"
PERIOD_NOT_EXPRESSIBLE = "FH-216"
JOURNAL_FILE = "FH-223"
NO_TORQUE_OFFSET = "FH-229"
UNITS_CONTRADICT = "FH-240"
UNIT_AMBIGUOUS = "FH-241"

EXPLANATIONS = {
    SDO_ABORT: Explanation(
        "reading, writing ...: SDO abort",
        "the drive refuses access or value",
        "look the abort code up in the drive's manual",
    ),
    OBJECT_MISSING: Explanation(
        "node ... lacks object ...",
        "not in this drive or firmware",
        "another mode; newer firmware",
    ),
    OBJECT_SIZE: Explanation(
        "... does not fit; has ... bits and not ...",
        "value too large; object narrower than in the standard",
        "another mode",
    ),
    WRONG_IDENTITY: Explanation(
        "... says 1018h ..., but the configuration's identity demands ...",
        "another drive under this number",
        "correct `node` or `identity`",
    ),
    MODE_NOT_SUPPORTED: Explanation(
        "... does not support mode ..., supports none of csp, csv, cst",
        "6502h does not list it",
        "a mode from the message; `is_mode_check_required: false` if 6502h is wrong",
    ),
    UNIT_UNKNOWN: Explanation(
        (
            "... does not report its encoder resolution, its rated torque; velocity in an unknown unit, or (csv) in "
            "one that is not shown"
        ),
        "object missing or empty; 60A9h aborted as not readable now",
        "`counts_per_unit`, `rated_torque`, `velocity_unit`",
    ),
    ALREADY_POWERED: Explanation(
        "node ... is in state operation enabled already",
        "another master, or one that ended without disabling",
        "`friction-hil stop CONFIG`, once no other master runs",
    ),
    PERIOD_NOT_EXPRESSIBLE: Explanation(
        "a drive cannot be given a period of ..., 60C2h stays at ...",
        "60C2h holds 1 to 255 times a power of ten, or is read-only",
        "another `period_s`, e.g. 1e-3 or 2e-3",
    ),
    JOURNAL_FILE: Explanation(
        "what the drive held before cannot be kept",
        "disk full, or no permission in the folder for temporary files",
        "make room; remove the file that the message names",
    ),
    NO_TORQUE_OFFSET: Explanation(
        "... lacks object 60B2h torque offset, 60B1h velocity offset",
        "csp and csv are compensated by it",
        "`compensation.velocity_offset`, for a drive without 60B1h with its `position_gain` (csp), mode `cst`, or "
        "`compensation: {enabled: false}`",
    ),
    UNITS_CONTRADICT: Explanation(
        "... says ..., but node ... says ...: a factor of ...",
        "wrong unit in the configuration, or an object that means something else at this vendor",
        "correct the key or leave it out; `trust: [KEY]` to insist",
    ),
    UNIT_AMBIGUOUS: Explanation(
        "the objects of node ... leave open what a count of 6064h is",
        "a gear without feed constant, or a feed constant that contradicts 608Fh",
        "`counts_per_unit`: turn the motor once by hand and read 6064h",
    ),
}
