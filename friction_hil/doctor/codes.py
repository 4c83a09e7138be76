"""Codes of all findings that are no pass, each with its message, cause and remedy."""

from friction_hil.drive.codes import Explanation

CODES = {
    # the machine
    "FH-301": Explanation(
        "no PREEMPT_RT",
        "The kernel does not let a real-time process interrupt its own work, so that drivers may delay a wake-up.",
        (
            "Install a kernel with PREEMPT_RT, or measure whether the latency suffices for the period: `friction-hil "
            "latency`."
        ),
    ),
    "FH-302": Explanation(
        "preemption model: not reported by this system",
        "`/proc/sys/kernel/version` cannot be read, as in some containers.",
        "Check on the host: `uname -v` shows `PREEMPT_RT`.",
    ),
    "FH-303": Explanation(
        "frequency governor: not reported by this system",
        "A virtual machine, or the firmware controls the processor clock.",
        "Choose the performance profile in the firmware or on the host.",
    ),
    "FH-304": Explanation(
        "frequency governor: ...",
        (
            "A governor other than `performance` reduces the clock of a processor that is mostly idle; the next "
            "cycle then computes late."
        ),
        "As root: `echo performance | tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor`",
    ),
    "FH-305": Explanation(
        "compiled kernels cannot be kept",
        (
            "The user has no home directory, or may not write to its cache, so that each start compiles for a minute "
            "or two."
        ),
        "Set `XDG_CACHE_HOME` to a folder that the user may write to.",
    ),
    "FH-306": Explanation(
        "no compiled kernels yet",
        "The first start after an installation or update takes a minute or two longer.",
        "`friction-hil demo` compiles and keeps them.",
    ),
    "FH-307": Explanation(
        "recording cannot be written",
        "The folder of `recording.path` is missing below a file, or the user may not write to it.",
        "Change `recording.path`, or give the user write access.",
    ),
    "FH-308": Explanation(
        "recording: little space is free",
        (
            "Less than 1 GiB or an hour is free, or less than `recording.budget_mb` may take; a recording stops "
            "while the disk is full."
        ),
        "Free some space, record to another disk, or set `recording.budget_mb` to what is free.",
    ),
    "FH-310": Explanation(
        "memory is not locked",
        "The system refused to lock the memory of the process; a page that was swapped out delays a cycle.",
        "Raise `memlock` in `/etc/security/limits.conf`; for a container `--ulimit memlock=-1`.",
    ),
    "FH-311": Explanation(
        "memory is locked, but the limit leaves little room",
        "Memory that is needed beyond the limit is refused.",
        "As for FH-310.",
    ),
    "FH-312": Explanation(
        "no SCHED_FIFO priority",
        "The system refused real-time scheduling: the loop runs at ordinary priority and other programs delay it.",
        (
            "Run as root, in a container with `--cap-add SYS_NICE`, or give the user `rtprio` in "
            "`/etc/security/limits.conf`."
        ),
    ),
    "FH-313": Explanation(
        "realtime.priority is 0",
        "The configuration switches real-time scheduling, locked memory and the limit on processor sleep off.",
        "Omit `realtime.priority` if punctuality matters.",
    ),
    "FH-314": Explanation(
        "/dev/cpu_dma_latency cannot be held",
        "The user may not open that device, or it is missing; wake-ups from deep sleep states take longer.",
        (
            "Run as root, or add a udev rule that gives the user write access; in a container `--device "
            "/dev/cpu_dma_latency`."
        ),
    ),
    "FH-315": Explanation(
        "the daemon needs Linux",
        (
            "Its loop relies on the real-time priority and the shared memory of Linux. Recordings can be replayed, "
            "identified and converted on this system."
        ),
        "Run the daemon on a Linux machine.",
    ),
    "FH-316": Explanation(
        "isolated processors: none",
        "The scheduler puts any process on any processor, and the kernel works on all of them.",
        "Boot with `isolcpus=3 nohz_full=3 rcu_nocbs=3`, for example, and start the daemon with `taskset -c 3`.",
    ),
    "FH-317": Explanation(
        "isolated processors: unknown",
        "`/sys/devices/system/cpu/isolated` cannot be read, as in some containers.",
        "Look for `isolcpus=` in `/proc/cmdline` of the host.",
    ),
    "FH-318": Explanation(
        "isolated processors are not used",
        "There are some, but a process that is started here does not run on them.",
        "Start the daemon with `taskset -c`, or `CPUAffinity=` in its service.",
    ),
    "FH-319": Explanation(
        "interrupts arrive at the loop's processor",
        "Each interrupt of a device there delays the loop.",
        "Stop irqbalance, and as root: `echo 0 > /proc/irq/NUMBER/smp_affinity_list` for each that is named.",
    ),
    "FH-320": Explanation(
        "affinity of interrupts: unknown",
        "`/proc/irq` cannot be read.",
        "Check on the host.",
    ),
    "FH-321": Explanation(
        "real-time throttling",
        (
            "The kernel stops real-time processes for the rest of a second of which they took the given share; a "
            "loop that spins for most of its period can reach it."
        ),
        "As root: `sysctl -w kernel.sched_rt_runtime_us=-1`; or a smaller `realtime.spin_us`.",
    ),
    "FH-322": Explanation(
        "real-time throttling: unknown",
        "`/proc/sys/kernel/sched_rt_runtime_us` cannot be read.",
        "Check on the host.",
    ),
    "FH-323": Explanation(
        "sleep states",
        "A processor takes the given time to leave its deepest sleep state, and the daemon may not keep it out.",
        "Let the user open `/dev/cpu_dma_latency` (FH-314); or as root: `cpupower idle-set -D 20`.",
    ),
    "FH-324": Explanation(
        "sleep states: unknown",
        "A virtual machine, or the firmware controls them.",
        "Switch C-states off in the firmware or on the host.",
    ),
    "FH-325": Explanation(
        "limits of the control group",
        (
            "A service or container has a quota of processor time, after which it stands still for the rest of each "
            "interval, or little memory."
        ),
        ("`CPUQuota=infinity` and `MemoryMax=infinity` in the service; a container without `--cpus` and `--memory`."),
    ),
    "FH-326": Explanation(
        "limits of the control group: unknown",
        "`/sys/fs/cgroup` is not mounted or cannot be read.",
        "Check on the host.",
    ),
    "FH-327": Explanation(
        "slow clock source",
        (
            "The kernel does not trust the clock of the processor and asks a device, which takes a microsecond or "
            "more each time."
        ),
        (
            "As root: `echo tsc > /sys/devices/system/clocksource/clocksource0/current_clocksource`, if it is "
            "available there; `dmesg` says why it was rejected."
        ),
    ),
    "FH-328": Explanation(
        "clock source: unknown",
        "`/sys/devices/system/clocksource` cannot be read.",
        "Check on the host.",
    ),
    "FH-329": Explanation(
        "disk: rows may be lost",
        ("The disk writes less than four times as fast as the recording needs, or takes seconds to write a megabyte."),
        "Record to a faster disk; fewer axes, or a longer `period_s`.",
    ),
    "FH-330": Explanation(
        "disk: its speed is unknown",
        "No file could be written to measure it.",
        "Free some space; see the message.",
    ),
    "FH-331": Explanation(
        "processor load: the machine is busy",
        "In the last minute nearly every processor, or more, was wanted: a loop of ordinary priority has to wait.",
        "End what computes beside the daemon, or give the daemon a processor of its own (`taskset`, `isolcpus=`).",
    ),
    "FH-332": Explanation(
        "processor load: unknown",
        "`/proc/loadavg` cannot be read.",
        "Check on the host.",
    ),
    # the configuration and its drivers
    "FH-401": Explanation(
        "configuration: cannot be read",
        "There is no such file, or the user may not read it.",
        "Give the path of a configuration that this user may read.",
    ),
    "FH-402": Explanation(
        "configuration: a mistake, with its key",
        "A value or key is wrong, in the configuration or in a file that it names.",
        "Correct the file and line given; `friction-hil config schema` describes every key.",
    ),
    "FH-403": Explanation(
        "model: the file does not exist yet",
        "The axis names a model file that is still to be made.",
        "`friction-hil tune` makes it.",
    ),
    "FH-404": Explanation(
        "model: a note on its values",
        "The model can be used, but its values are unusual, such as `static` below `coulomb`.",
        "Check whether the values in the model file are intended.",
    ),
    "FH-405": Explanation(
        "driver: it cannot be imported",
        "A package that the driver needs is not installed.",
        'Install it with pip, e.g. `pip install "friction-hil[dynamixel]"`.',
    ),
    "FH-406": Explanation(
        "driver: has no checks of its connection",
        "A driver of another package without `check_connection`.",
        "`friction-hil run` with `--dry-run` connects and only listens.",
    ),
    "FH-407": Explanation(
        "driver: an error",
        "The driver's checks ended with an error that concerns none of the checks below.",
        "See the message.",
    ),
    # drives on serial lines
    "FH-411": Explanation(
        "serial ports: /dev has no ...",
        "The kernel has the port, but its device file is missing, as in a container.",
        "Start the container with `--device` and the port.",
    ),
    "FH-412": Explanation(
        "serial ports: none",
        "No adapter is plugged in, or the kernel has no driver for it.",
        "Plug it in; `dmesg` shows whether the kernel recognised it.",
    ),
    "FH-413": Explanation(
        "permission denied",
        "The user may not open the port.",
        "Add the user to the group of the device, usually `dialout`, and log in again.",
    ),
    "FH-414": Explanation(
        "the user is not in the group dialout",
        "No port is there now; one that is plugged in later could not be opened.",
        "As for FH-413.",
    ),
    "FH-415": Explanation(
        "the USB adapter holds short replies back",
        (
            "The adapter waits, 16 ms by default, before it passes a short reply on. It is a `fail` if a cycle then "
            "takes longer than the period."
        ),
        "As root: `echo 1 > /sys/bus/usb-serial/devices/ttyUSB0/latency_timer`; or a longer `period_s`.",
    ),
    "FH-416": Explanation(
        "line: the port cannot be opened, or no connection",
        (
            "There is no such port, another process has it open, the user may not open it, or nothing listens at the "
            "TCP address."
        ),
        (
            "As the message says: plug the adapter in, correct `line.port`, end the other process, or switch the "
            "drive on."
        ),
    ),
    "FH-418": Explanation(
        "the drive does NOT watch the daemon",
        "The drive has no watchdog: if the daemon dies, its last torque stays.",
        "Keep the emergency stop in reach.",
    ),
    "FH-419": Explanation(
        "description: no manual was read for these",
        "Addresses or messages of the description were inferred from similar drives and never tried.",
        "Check the named signals with `friction-hil run` and `--dry-run`, or against the drive's manual.",
    ),
    "FH-420": Explanation(
        "nothing reads ... of the drive: it cannot be read back",
        "The description has no request that reads the watchdog, so that a drive that refused it is not noticed.",
        "Describe such a request, if the drive has one; otherwise try the watchdog on the drive.",
    ),
    # drives on CANopen
    "FH-431": Explanation(
        "CAN interfaces: none",
        "No adapter is plugged in, or its kernel module is not loaded.",
        "Plug it in; without hardware `modprobe vcan && ip link add dev vcan0 type vcan && ip link set vcan0 up`.",
    ),
    "FH-432": Explanation(
        "CAN interface: it is down",
        "The interface was not brought up after the start of the system.",
        "`ip link set can0 up type can bitrate 1000000`, with the bit rate of the drives.",
    ),
    "FH-433": Explanation(
        "BUS-OFF",
        ("After too many errors the controller has left the bus: wrong bit rate, no termination, or a short circuit."),
        "Check wiring and bit rate; then `ip link set can0 type can restart`.",
    ),
    "FH-434": Explanation(
        "it runs at ... bit/s, the configuration says ...",
        "The interface was brought up with another bit rate than `bus.bitrate`.",
        "Correct `bus.bitrate`, or bring the interface up again.",
    ),
    "FH-435": Explanation(
        "ERROR-WARNING or ERROR-PASSIVE",
        "The controller has counted errors on the bus.",
        "Check wiring, terminating resistors and the bit rate of all nodes.",
    ),
    "FH-436": Explanation(
        "bit rate not reported by this system",
        "The program `ip` is missing, so the bit rate cannot be compared.",
        "Install iproute2.",
    ),
    "FH-437": Explanation(
        "bus: it cannot be opened",
        "There is no such interface, python-can does not know it, or its package is missing.",
        "As the message says; it lists the interfaces that exist.",
    ),
    "FH-438": Explanation(
        "permission denied, or no such device",
        "The device file of an adapter on a serial port is missing or not accessible.",
        "Plug the adapter in; `ls -l /dev` shows who may open it.",
    ),
    "FH-439": Explanation(
        "is not opened here",
        "The adapter takes part in the bus as soon as it is opened, so doctor leaves it closed.",
        "`friction-hil run` with `--dry-run` opens it and commands nothing.",
    ),
    "FH-440": Explanation(
        "bus load: a cycle needs more than 90 % of the period",
        "SYNC and the PDOs of all axes do not fit into the period, with room for SDO, heartbeats and emergencies.",
        "A longer `period_s`, a higher bit rate, or fewer axes.",
    ),
    "FH-441": Explanation(
        "node: belongs to another daemon already",
        "Another daemon of this machine drives the axis; its process number is in the message.",
        "Stop that one first.",
    ),
    "FH-442": Explanation(
        "not seen to act; not known",
        (
            "The drive did nothing when the daemon was silent; some watch only while they are enabled. It fails if "
            "no watchdog of the drive was seen. Or this computer fed the drive too late, three times, so that what "
            "the drive did proves nothing."
        ),
        "Do not rely on it: another watchdog, or an emergency stop at hand. A quiet computer.",
    ),
    "FH-443": Explanation(
        "it reports the loss, but the drive stays switched on",
        "An emergency came, but no reaction without torque.",
        "Its manual: many drives react only while they are enabled (6007h, 1029h).",
    ),
    "FH-444": Explanation(
        "the drive does not watch the daemon",
        "It has no event-driven RPDO with a timer, no 1016h and no 100Ch, or does not react to their loss.",
        "An emergency stop at hand.",
    ),
    "FH-445": Explanation(
        "watchdogs could not be tried; it trips although it is fed",
        ("The drive was not reached, is powered, has another master, or trips too early; or the driver has no trial."),
        "As the message says.",
    ),
}
