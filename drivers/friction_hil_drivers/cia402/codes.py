"""Codes of fault messages that the objects of a drive give rise to, on whatever bus."""

from friction_hil.drive.codes import Explanation

SDO_ABORT = "FH-208"
OBJECT_MISSING = "FH-209"
OBJECT_SIZE = "FH-210"
UNIT_UNKNOWN = "FH-214"
JOURNAL_FILE = "FH-223"
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
    UNIT_UNKNOWN: Explanation(
        (
            "... does not report its encoder resolution, its rated torque; velocity in an unknown unit, or (csv) in "
            "one that is not shown"
        ),
        "object missing or empty; 60A9h aborted as not readable now",
        "`counts_per_unit`, `rated_torque`, `velocity_unit`",
    ),
    JOURNAL_FILE: Explanation(
        "what the drive held before cannot be kept",
        "disk full, or no permission in the folder for temporary files",
        "make room; remove the file that the message names",
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
