/* A servo drive behind libmodbus, for tests of the driver: nothing of it is shared with the product.

   modbus_slave rtu DEVICE UNIT WORD_ORDER
   modbus_slave tcp PORT UNIT WORD_ORDER

   Registers as in the description "generic CiA 402 drive"; WORD_ORDER is big or little. Of the modes it has torque
   alone. One millisecond passes with each request that reads the position, so no clock is involved in the motion; only
   the watchdog (register 107h, ms without a command) is in real time. "ready" on standard output says that it listens. */

#include <errno.h>
#include <math.h>
#include <modbus.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { STATUS = 0, ERROR_CODE = 1, TORQUE = 2, POSITION = 3, VELOCITY = 5, FEEDBACK_END = 7 };
enum { COMMANDS = 0x100, TORQUE_COMMAND = 0x102, CONTROL = 0x105, MODE = 0x106, WATCHDOG = 0x107, END = 0x108 };
enum { READ = 3, WRITE_ONE = 6, WRITE_MANY = 16, READ_AND_WRITE = 23 };
enum { TORQUE_MODE = 10, COMMUNICATION_ERROR = 0x8100 };

/* statusword of each state, CiA 402-2 table 28 ff. */
enum { DISABLED = 0x40, READY = 0x21, SWITCHED_ON = 0x23, ENABLED = 0x27, STOPPING = 0x07, FAULT = 0x08 };

static const double STEP_S = 1e-3, INERTIA = 2e-4, FRICTION = 0.05, RATED_TORQUE = 0.64;
static const double COUNTS = (1 << 20) / 6.283185307179586; /* per rad */

static uint16_t *registers;
static int is_little_endian, state = DISABLED, control_before;
static double fed_s; /* when a command came last */
static double torque, velocity, position = -1e6; /* N m, rad/s, counts */

static double now_s(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec + now.tv_nsec * 1e-9;
}

/* Nobody sees the drive between requests: it is enough to look at the watchdog when one has come. */
static void watch(void) {
    double limit_s = registers[WATCHDOG] * 1e-3;
    if (state == ENABLED && limit_s > 0.0 && now_s() - fed_s > limit_s) {
        state = FAULT;
        registers[ERROR_CODE] = COMMUNICATION_ERROR;
    }
}

static void put(int address, double number) {
    uint32_t bits = (uint32_t)(int64_t)llround(number);
    registers[address + is_little_endian] = bits >> 16;
    registers[address + !is_little_endian] = bits & 0xffff;
}

static void show(void) {
    registers[STATUS] = state | 0x0210; /* remote, voltage enabled */
    registers[TORQUE] = (uint16_t)(int16_t)lround(torque / RATED_TORQUE * 1000.0);
    put(POSITION, position);
    put(VELOCITY, velocity * COUNTS);
}

static void move(void) {
    torque = state == ENABLED ? (int16_t)registers[TORQUE_COMMAND] / 1000.0 * RATED_TORQUE : 0.0;
    double after = velocity + torque / INERTIA * STEP_S, lost = FRICTION / INERTIA * STEP_S;
    velocity = fabs(after) <= lost ? 0.0 : after - copysign(lost, after);
    position += velocity * STEP_S * COUNTS;
    if (state == STOPPING && velocity == 0.0)
        state = DISABLED;
}

static void obey(int word) {
    int is_reset = word & ~control_before & 0x80;
    control_before = word;
    if (state == FAULT) {
        if (is_reset) {
            state = DISABLED;
            registers[ERROR_CODE] = 0;
        }
    } else if (!(word & 0x02)) { /* disable voltage */
        state = DISABLED;
    } else if (!(word & 0x04)) { /* quick stop */
        if (state == ENABLED)
            state = STOPPING;
        else if (state != STOPPING)
            state = DISABLED;
    } else if (!(word & 0x01)) { /* shutdown */
        if (state != STOPPING)
            state = READY;
    } else if (!(word & 0x08)) { /* switch on, disable operation */
        if (state == READY || state == ENABLED)
            state = SWITCHED_ON;
    } else if (state == SWITCHED_ON) { /* enable operation */
        state = ENABLED;
    }
}

static int is_inside(int address, int count) {
    if (count < 1)
        return 0;
    return (address >= 0 && address + count <= FEEDBACK_END) || (address >= COMMANDS && address + count <= END);
}

static int number_at(const uint8_t *bytes) { return bytes[0] << 8 | bytes[1]; }

/* Answer one request; what it writes takes effect after what it reads was sampled. */
static void answer(modbus_t *bus, modbus_mapping_t *map, const uint8_t *query, int length) {
    const uint8_t *pdu = query + modbus_get_header_length(bus);
    int function = pdu[0], address = number_at(pdu + 1), count = number_at(pdu + 3);
    int reads = function == READ || function == READ_AND_WRITE;
    int first = 0, written = 0;
    const uint8_t *values = pdu + 3;
    if (function == WRITE_ONE) {
        first = address, written = count = 1;
    } else if (function == WRITE_MANY) {
        first = address, written = count, values = pdu + 6;
    } else if (function == READ_AND_WRITE) {
        first = number_at(pdu + 5), written = number_at(pdu + 7), values = pdu + 10;
    } else if (!reads) {
        modbus_reply_exception(bus, query, MODBUS_EXCEPTION_ILLEGAL_FUNCTION);
        return;
    }
    if (!is_inside(address, count) || (written && (first < COMMANDS || !is_inside(first, written)))) {
        modbus_reply_exception(bus, query, MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS);
        return;
    }
    int has_mode = written && first <= MODE && MODE < first + written;
    if (has_mode && number_at(values + 2 * (MODE - first)) != TORQUE_MODE) {
        modbus_reply_exception(bus, query, MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE);
        return;
    }
    if (reads && address <= POSITION && POSITION < address + count)
        move();
    show();
    modbus_reply(bus, query, length, map);
    if (written)
        fed_s = now_s();
    if (written && first <= CONTROL && CONTROL < first + written)
        obey(registers[CONTROL]);
}

/* Serve until the master is gone. */
static void serve(modbus_t *bus, modbus_mapping_t *map, int is_tcp) {
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    for (;;) {
        int length = modbus_receive(bus, query);
        watch();
        if (length > 0)
            answer(bus, map, query, length);
        else if (length < 0 && is_tcp && errno != EMBBADDATA)
            return;
        else if (length < 0 && errno == EIO)
            exit(0); /* the line is gone */
    }
}

int main(int count, char **words) {
    if (count != 5)
        return 2;
    int is_tcp = !strcmp(words[1], "tcp"), unit = atoi(words[3]), listener = -1;
    is_little_endian = !strcmp(words[4], "little");
    modbus_t *bus = is_tcp ? modbus_new_tcp("127.0.0.1", atoi(words[2])) : modbus_new_rtu(words[2], 921600, 'N', 8, 1);
    modbus_mapping_t *map = modbus_mapping_new(0, 0, END, 0);
    if (!bus || !map || modbus_set_slave(bus, unit) < 0)
        return 1;
    registers = map->tab_registers;
    show();
    if (is_tcp ? (listener = modbus_tcp_listen(bus, 1)) < 0 : modbus_connect(bus) < 0) {
        fprintf(stderr, "%s: %s\n", words[2], modbus_strerror(errno));
        return 1;
    }
    puts("ready");
    fflush(stdout);
    do {
        if (is_tcp && modbus_tcp_accept(bus, &listener) < 0)
            return 1;
        serve(bus, map, is_tcp);
        close(modbus_get_socket(bus));
    } while (is_tcp);
}
