"""Codes of the CANopen driver's fault messages, and the remedy of each; README.md has the causes too."""

BUS_NOT_OPENED = "FH-201"
BUS_FAILED = "FH-202"
SECOND_MASTER = "FH-203"
NODE_LOCKED = "FH-204"
LOCK_FAILED = "FH-205"
NO_ANSWER = "FH-206"
ANSWER_LOST = "FH-207"
SDO_ABORT = "FH-208"
OBJECT_MISSING = "FH-209"
OBJECT_SIZE = "FH-210"
WRONG_IDENTITY = "FH-211"
MODE_NOT_SUPPORTED = "FH-212"
WRONG_EDS = "FH-213"
UNIT_UNKNOWN = "FH-214"
ALREADY_POWERED = "FH-215"
PERIOD_NOT_EXPRESSIBLE = "FH-216"
NO_WATCHDOG = "FH-217"
BUS_OVERLOAD = "FH-218"
MAPPING_NOT_KEPT = "FH-219"
MASTER_APPEARED = "FH-220"
NOTHING_TO_HEAR = "FH-221"
NOT_RESTORED = "FH-222"
JOURNAL_FILE = "FH-223"
NO_MAPPING = "FH-227"
UNKNOWN_ENTRY = "FH-228"
NO_TORQUE_OFFSET = "FH-229"
HEARTBEAT_LOST = "FH-230"
NODE_RESTARTED = "FH-231"
NOT_OPERATIONAL = "FH-232"
WRONG_MODE = "FH-233"
SYNC_NOT_ANSWERED = "FH-234"
FEEDBACK_LATE = "FH-235"
PDO_LENGTH = "FH-236"
COMMANDS_TOO_OLD = "FH-237"
UNITS_CONTRADICT = "FH-240"
UNIT_AMBIGUOUS = "FH-241"
NODE_SILENT = "FH-244"
NODE_TAKEN = "FH-245"
SYNC_UNUSABLE = "FH-247"
SYNC_LOST = "FH-248"
PDO_NOT_AS_STATED = "FH-249"
NMT_STATE_UNKNOWN = "FH-268"
WATCHDOG_SLOW = "FH-269"
MAX_MISSED_NOT_MET = "FH-270"
TWO_NODES = "FH-264"
WOULD_DISTURB = "FH-265"
SYNC_ID_FIXED = "FH-266"

TITLES = {
    BUS_NOT_OPENED: "The CAN bus does not open",
    BUS_FAILED: "The CAN bus cannot send or receive any more",
    SECOND_MASTER: "Another master sends SYNC on the bus",
    NODE_LOCKED: "Another daemon of this machine drives the node",
    LOCK_FAILED: "The lock of a node cannot be taken",
    NO_ANSWER: "No node answers under the configured number",
    ANSWER_LOST: "A node stopped answering while it was being configured",
    SDO_ABORT: "A drive refuses to read or write an object",
    OBJECT_MISSING: "A drive lacks an object that is needed",
    OBJECT_SIZE: "A value or an object has a size that does not fit",
    WRONG_IDENTITY: "The drive is not the one that the configuration names",
    MODE_NOT_SUPPORTED: "The drive does not support the mode of operation",
    WRONG_EDS: "The EDS is not that of the drive",
    UNIT_UNKNOWN: "A unit of the drive is not known",
    ALREADY_POWERED: "The drive is powered before the daemon enabled it",
    PERIOD_NOT_EXPRESSIBLE: "The period cannot be written as an interpolation period",
    NO_WATCHDOG: "The drive cannot watch the daemon",
    BUS_OVERLOAD: "A cycle does not fit on the bus",
    MAPPING_NOT_KEPT: "The drive keeps another PDO mapping than was written",
    MASTER_APPEARED: "Another master appears during a run",
    NOTHING_TO_HEAR: "A dry run beside another master gets no feedback",
    NOT_RESTORED: "A drive is not left as it was found",
    JOURNAL_FILE: "The values found in a drive cannot be kept on disk",
    NO_MAPPING: "No PDO of a drive carries an object that is needed",
    UNKNOWN_ENTRY: "A fixed PDO mapping carries an object whose value is not known",
    NO_TORQUE_OFFSET: "A drive cannot be given a compensation in this mode",
    HEARTBEAT_LOST: "The heartbeat of a node is missing",
    NODE_RESTARTED: "A node restarted during the run",
    NOT_OPERATIONAL: "A node left the state Operational",
    WRONG_MODE: "An enabled drive is in another mode of operation",
    SYNC_NOT_ANSWERED: "Drives do not answer SYNC in simulated time",
    FEEDBACK_LATE: "TPDOs answer an earlier SYNC",
    PDO_LENGTH: "A TPDO has another length than its mapping",
    COMMANDS_TOO_OLD: "Commands were too old to be sent",
    UNITS_CONTRADICT: "The configuration contradicts a unit that the drive reports",
    UNIT_AMBIGUOUS: "The drive's objects leave open which unit its position has",
    NODE_SILENT: "A node to be shown or stopped does not answer",
    NODE_TAKEN: "A node to be simulated is on the bus already",
    SYNC_UNUSABLE: "A sidecar hears no SYNC of its period",
    SYNC_LOST: "A sidecar has lost SYNC, or hears two of them",
    PDO_NOT_AS_STATED: "A PDO is not as the configuration of a sidecar says",
    NMT_STATE_UNKNOWN: "It is not known in which NMT state a node was found",
    WATCHDOG_SLOW: "A drive's watchdogs act later than the bridged periods ask for",
    MAX_MISSED_NOT_MET: "A drive's watchdogs act later than the configuration demands",
    TWO_NODES: "Two nodes on the bus have the same number",
    WOULD_DISTURB: "Reading a node would disturb the SDO transfers of another master",
    SYNC_ID_FIXED: "A drive takes SYNC by another identifier, and keeps it",
}

REMEDIES = {
    BUS_NOT_OPENED: "the command in the message",
    BUS_FAILED: "`ip -details link show can0`; check wires, terminating resistors, bit rate",
    SECOND_MASTER: "stop the other master; `--dry-run` listens beside it",
    NODE_LOCKED: "stop the process that the message names",
    LOCK_FAILED: "allow the daemon such sockets; the message has the system's reason",
    NO_ANSWER: "check the drive's supply, node number, bit rate and wires; `candump can0` shows boot-up messages",
    ANSWER_LOST: "check supply and wires",
    SDO_ABORT: "look the abort code up in the drive's manual",
    OBJECT_MISSING: "another mode; newer firmware",
    OBJECT_SIZE: "another mode",
    WRONG_IDENTITY: "correct `node` or `identity`",
    MODE_NOT_SUPPORTED: "a mode from the message; `is_mode_check_required: false` if 6502h is wrong",
    WRONG_EDS: "the matching EDS, or none",
    UNIT_UNKNOWN: "`counts_per_unit`, `rated_torque`, `velocity_unit`",
    ALREADY_POWERED: "`friction-hil stop CONFIG`, once no other master runs",
    PERIOD_NOT_EXPRESSIBLE: "another `period_s`, e.g. 1e-3 or 2e-3",
    NO_WATCHDOG: "`is_watchdog_required: false`, with an emergency stop at hand",
    BUS_OVERLOAD: "longer `period_s`, higher bit rate, fewer axes",
    MAPPING_NOT_KEPT: "unlock PDO mapping in the drive",
    MASTER_APPEARED: "stop the other master",
    NOTHING_TO_HEAR: "let that master map statusword, position, torque, velocity and mode; or stop it",
    NOT_RESTORED: "write it with the vendor's tool, or switch the drive off and on; the next run tries again",
    JOURNAL_FILE: "make room; remove the file that the message names",
    NO_MAPPING: "the message has each refusal; another mode, or map the PDOs with the vendor's tool",
    UNKNOWN_ENTRY: "take that object out of the mapping with the vendor's tool",
    NO_TORQUE_OFFSET: "mode `cst`, or `compensation: {enabled: false}`",
    HEARTBEAT_LOST: "check supply and wires; `heartbeat_s` longer on a busy bus",
    NODE_RESTARTED: "check the supply; stop other masters",
    NOT_OPERATIONAL: "the drive's emergency says why; stop other masters",
    WRONG_MODE: "close the vendor's tool; check 6502h",
    SYNC_NOT_ANSWERED: "start `friction-hil simulate FILE --pace sync`; 1005h of a drive must be `bus.sync_cob_id`",
    FEEDBACK_LATE: "a longer `period_s`; another adapter; less traffic on the bus",
    PDO_LENGTH: "set the drive up anew; look for a second node with this number",
    COMMANDS_TOO_OLD: "`friction-hil doctor`; see FH-113",
    UNITS_CONTRADICT: "correct the key or leave it out; `trust: [KEY]` to insist",
    UNIT_AMBIGUOUS: "`counts_per_unit`: turn the motor once by hand and read 6064h",
    NODE_SILENT: "check supply and wires; `friction-hil drives scan`",
    NODE_TAKEN: "end the other one, or give the axis another `node` or the bus another channel",
    SYNC_UNUSABLE: "start the master first; `bus.sync_cob_id`; `period_s` as the master's",
    SYNC_LOST: "the offset was faded out; start again beside a running master",
    PDO_NOT_AS_STATED: "an RPDO of its own; `entries` as in the master's project; transmission type 1",
    NMT_STATE_UNKNOWN: "`NMT start` by its master, if that expects it Operational",
    WATCHDOG_SLOW: "count on that time; a drive with an RPDO timer or a finer 1016h is faster",
    MAX_MISSED_NOT_MET: "the `realtime.max_missed` of the message, or none, which makes it a warning",
    TWO_NODES: "a node number of its own for each drive, set with one of them on the bus at a time",
    WOULD_DISTURB: "stop the other master, or its SDO; `bus.role: sidecar` needs none; `drives show --may-disturb`",
    SYNC_ID_FIXED: "`bus.sync_cob_id` as in the message, for all drives of the bus",
}
