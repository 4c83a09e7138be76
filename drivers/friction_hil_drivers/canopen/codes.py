"""Codes of the CANopen driver's fault messages, beside those of CiA 402, with message, cause and remedy."""

from friction_hil.drive.codes import Explanation
from friction_hil_drivers.cia402 import codes

BUS_NOT_OPENED = "FH-201"
BUS_FAILED = "FH-202"
SECOND_MASTER = "FH-203"
NODE_LOCKED = "FH-204"
LOCK_FAILED = "FH-205"
NO_ANSWER = "FH-206"
ANSWER_LOST = "FH-207"
WRONG_EDS = "FH-213"
NO_WATCHDOG = "FH-217"
BUS_OVERLOAD = "FH-218"
MAPPING_NOT_KEPT = "FH-219"
MASTER_APPEARED = "FH-220"
NOTHING_TO_HEAR = "FH-221"
NOT_RESTORED = "FH-222"
NO_MAPPING = "FH-227"
UNKNOWN_ENTRY = "FH-228"
HEARTBEAT_LOST = "FH-230"
NODE_RESTARTED = "FH-231"
NOT_OPERATIONAL = "FH-232"
WRONG_MODE = "FH-233"
SYNC_NOT_ANSWERED = "FH-234"
FEEDBACK_LATE = "FH-235"
PDO_LENGTH = "FH-236"
COMMANDS_TOO_OLD = "FH-237"
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

EXPLANATIONS = codes.EXPLANATIONS | {
    BUS_NOT_OPENED: Explanation(
        "the bus ... does not open",
        "interface missing or down, no permission, no multicast route",
        "the command in the message",
    ),
    BUS_FAILED: Explanation(
        "the bus ... cannot send, cannot be read any more",
        "bus-off, interface taken down, adapter unplugged, send queue full because no node acknowledges",
        "`ip -details link show can0`; check wires, terminating resistors, bit rate",
    ),
    SECOND_MASTER: Explanation(
        "another master is at work",
        "a second daemon, a PLC or a vendor's tool on this bus; the message has what was heard",
        "stop the other master; `--dry-run` listens beside it",
    ),
    NODE_LOCKED: Explanation(
        "node ... belongs to another daemon already",
        "a daemon of this machine drives the node",
        "stop the process that the message names",
    ),
    LOCK_FAILED: Explanation(
        "the lock of node ... cannot be taken",
        "a security policy forbids sockets in the abstract namespace",
        "allow the daemon such sockets; the message has the system's reason",
    ),
    NO_ANSWER: Explanation(
        "no drive answers as node ...",
        "drive off, other node number or bit rate, wires",
        "check the drive's supply, node number, bit rate and wires; `candump can0` shows boot-up messages",
    ),
    ANSWER_LOST: Explanation(
        "node ... stopped answering",
        "drive switched off or reset meanwhile, frames lost",
        "check supply and wires",
    ),
    WRONG_EDS: Explanation(
        "this EDS is not this drive's",
        "EDS of another type or firmware",
        "the matching EDS, or none",
    ),
    NO_WATCHDOG: Explanation(
        "node ... cannot watch the daemon",
        "RPDO timers, 1016h and 100Ch, or 6007h, missing or refused: the message has each with its abort code",
        "`is_watchdog_required: false`, with an emergency stop at hand",
    ),
    BUS_OVERLOAD: Explanation(
        "a cycle needs ... µs on the bus",
        "too many axes or too slow a bus",
        "longer `period_s`, higher bit rate, fewer axes",
    ),
    MAPPING_NOT_KEPT: Explanation(
        "... holds ... after ... was written",
        "the drive keeps its own mapping",
        "unlock PDO mapping in the drive",
    ),
    MASTER_APPEARED: Explanation(
        "another master has appeared on the bus",
        "a PLC or tool was started during the run",
        "stop the other master",
    ),
    NOTHING_TO_HEAR: Explanation(
        "... TPDOs as they are do not give the feedback",
        "dry run beside another master, whose mapping lacks an object",
        "let that master map statusword, position, torque, velocity and mode; or stop it",
    ),
    NOT_RESTORED: Explanation(
        "not restored: ...",
        "the drive refuses the value, has power, or does not answer",
        "write it with the vendor's tool, or switch the drive off and on; the next run tries again",
    ),
    NO_MAPPING: Explanation(
        "no RPDOs, TPDOs of ... carry ...",
        "the drive refuses the mapping, and none that it has contains what is needed",
        "the message has each refusal; another mode, or map the PDOs with the vendor's tool",
    ),
    UNKNOWN_ENTRY: Explanation(
        "... has a fixed mapping, which carries ... too",
        "its value cannot be read, so that nothing harmless can be sent in its place",
        "take that object out of the mapping with the vendor's tool",
    ),
    HEARTBEAT_LOST: Explanation(
        "no heartbeat from node ...",
        "drive off or stuck, wires",
        "check supply and wires; `heartbeat_s` longer on a busy bus",
    ),
    NODE_RESTARTED: Explanation(
        "node ... restarted (boot-up message)",
        "supply dip, watchdog reset, NMT reset by another master",
        "check the supply; stop other masters",
    ),
    NOT_OPERATIONAL: Explanation(
        "node ... left Operational",
        "the drive reacts to an error (1029h), or another master",
        "the drive's emergency says why; stop other masters",
    ),
    WRONG_MODE: Explanation(
        "the drive is in mode ... and not in ...",
        "mode refused or changed by another tool",
        "close the vendor's tool; check 6502h",
    ),
    SYNC_NOT_ANSWERED: Explanation(
        "not every drive has answered SYNC",
        "simulated drives ended or were never started; 1005h is another identifier",
        "start `friction-hil simulate FILE --pace sync`; 1005h of a drive must be `bus.sync_cob_id`",
    ),
    FEEDBACK_LATE: Explanation(
        "the TPDOs ... answer SYNC N cycles late, or come after the time kept for them",
        "a gateway or adapter that holds frames back, a bus that is too full, a slow drive",
        "a longer `period_s`; another adapter; less traffic on the bus",
    ),
    PDO_LENGTH: Explanation(
        "TPDO ... has ... bytes instead of ...",
        "the drive changed its mapping, or another node uses the identifier",
        "set the drive up anew; look for a second node with this number",
    ),
    COMMANDS_TOO_OLD: Explanation(
        "a command was not sent because it was ... ms old",
        "the daemon was held up between feedback and command",
        "`friction-hil doctor`; see FH-113",
    ),
    NODE_SILENT: Explanation(
        "node ... answers no SDO request; no node answers",
        "drive off, other node number or bit rate, NMT state Stopped",
        "check supply and wires; `friction-hil drives scan`",
    ),
    NODE_TAKEN: Explanation(
        "node ... is simulated by another process, or answers already",
        "a second `friction-hil simulate` on the same bus, or a drive of this number",
        "end the other one, or give the axis another `node` or the bus another channel",
    ),
    SYNC_UNUSABLE: Explanation(
        "no SYNC within 5 s; the SYNC gives no time base",
        "the master is off, uses another identifier or period, or two controllers send SYNC",
        "start the master first; `bus.sync_cob_id`; `period_s` as the master's",
    ),
    SYNC_LOST: Explanation(
        "SYNC did not come for N periods, comes more than once a period, comes every ... ms",
        "the master has stopped or changed its period, the cable is cut, a second SYNC producer",
        "the offset was faded out; start again beside a running master",
    ),
    PDO_NOT_AS_STATED: Explanation(
        (
            "somebody sends ... already, somebody else sends ...; ... comes with N bytes, but its entries have M; "
            "... comes with every N. SYNC only"
        ),
        "the offset's RPDO is the master's or another sidecar's; the mapping is not as stated",
        "an RPDO of its own; `entries` as in the master's project; transmission type 1",
    ),
    NMT_STATE_UNKNOWN: Explanation(
        "whether node ... was Operational before is not known",
        "it sends no heartbeat, so that its NMT state could not be read",
        "`NMT start` by its master, if that expects it Operational",
    ),
    WATCHDOG_SLOW: Explanation(
        "... stops the drive within ... ms, because it takes no time shorter than ...",
        "the drive counts its watchdogs in coarse steps",
        "count on that time; a drive with an RPDO timer or a finer 1016h is faster",
    ),
    MAX_MISSED_NOT_MET: Explanation(
        "the same, and realtime.max_missed is written",
        "as FH-269",
        "the `realtime.max_missed` of the message, or none, which makes it a warning",
    ),
    TWO_NODES: Explanation(
        ("two nodes answer as node ...; ... comes twice in each cycle; a second node with this number was switched on"),
        "two drives have one number (most are delivered with 1); or an adapter or gateway repeats every frame",
        "a node number of its own for each drive, set with one of them on the bus at a time",
    ),
    WOULD_DISTURB: Explanation(
        "another master reads or writes node ... by SDO",
        "a node has one SDO server: requests of two masters make each other's transfers fail",
        "stop the other master, or its SDO; `bus.role: sidecar` needs none; `drives show --may-disturb`",
    ),
    SYNC_ID_FIXED: Explanation(
        "node ... takes SYNC as ...",
        "its 1005h is not `bus.sync_cob_id` and is read-only",
        "`bus.sync_cob_id` as in the message, for all drives of the bus",
    ),
}

REMEDIES = {code: each.remedy for code, each in EXPLANATIONS.items()}
