"""Register maps: their mistakes, the ready ones, and the requests that follow from them."""

import struct
from random import Random

import pytest
from friction_hil_drivers.modbus.codec import ModbusExchange
from friction_hil_drivers.modbus.description import DESCRIPTIONS, ModbusDescription
from friction_hil_drivers.modbus.options import ModbusOptions
from friction_hil_drivers.serial_line.description import load_description, ready
from friction_hil_drivers.serial_line.protocol import FAST, SLOW, CycleSignals
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from friction_hil.errors import ConfigurationError, UsageError
from tests.unit.modbus.test_modbus_codec import CSP, SIGNALS, TCP, described, on_line, with_crc


def planned(description, commands=("torque_command",)):
    line, _ = on_line(description)
    fast = tuple(name for name in FAST if name in description.signals)
    slow = tuple(name for name in SLOW if name in description.signals)
    return line.plan({"a": CycleSignals(fast, slow, commands)})


def labels(plan):
    """Return the labels of the exchanges of a plan, without the unit."""
    return [[e.label.removesuffix(" of unit 1") for e in part] for part in (plan.poll, plan.background, plan.push)]


class TestMistakes:
    @pytest.mark.parametrize(
        ("changed", "keys", "text"),
        [
            ({"torque": {"address": 1, "type": "bool"}}, {}, "torque is bool in holding"),
            ({"torque": {"address": 1, "function": "coil"}}, {}, "torque is int16 in coil"),
            ({"position": {"address": 65535, "type": "int32", "unit": "count"}}, {}, "position does not end"),
            ({}, {"word_order": None}, "position .*word_order"),
            ({"torque_command": {"address": 1, "function": "input"}}, {}, "torque_command is written"),
            ({"status": {"address": 0x20, "type": "uint16"}}, {}, "control .0020h.*status"),
            ({"error": {"address": 0x32}}, {"modes": {"csp": {"commands": CSP}}}, "error .0032h."),
            ({"error": {"address": 0x31}}, {"alignment": 2, "write_functions": [16]}, "overwrite error"),
            ({}, {"alignment": 2, "write_functions": [6]}, "torque_command .* function 16"),
            ({}, {"write_functions": [5]}, "control .*function 6 or 16"),
            ({}, {"modes": {"csp": {"commands": CSP}}, "write_functions": [6]}, "position_command .* function 16;"),
            (
                {"brake": {"address": 1, "type": "bool", "function": "coil"}},
                {"prepare": [{"write": {"brake": 1}}]},
                "brake .*function 5 or 15",
            ),
            ({}, {"prepare": [{"write": {"control": 0, "torque_command": 0}}]}, r"prepare\.0\s+writes .* side by side"),
            ({"torque": {"address": 0x13}}, {}, r"signals\.position\s+position .*0012h. .*torque"),
            ({}, {"prepare": [{"write": {"control": 70000}}]}, r"prepare\.0\.write\.control\s+control .* to 65535"),
            ({}, {"prepare": [{"write": {"control": -1}}]}, "control .*from 0 to 65535, not -1"),
            ({}, {"prepare": [{"write": {"control": 0.5}}]}, "control takes whole numbers"),
            ({"position": None}, {}, "signal position"),
            ({"torque": {"address": 1, "adress": 2}}, {}, "adress"),
            ({"torque": {"address": 1, "register": 2}}, {}, "register"),
        ],
    )
    def test_are_told(self, changed, keys, text):
        with pytest.raises(ValidationError, match=text):
            described(changed, **keys)

    @pytest.mark.parametrize(
        ("replaced", "expected"),
        [
            ({"0x3700, type: int32": "0x3700, type: int33"}, [("0x3700", "int32")]),
            (
                {"mode: 4": "mode: 40000", "word_order: little\n": "\n"},
                [("mode: 40000", "to 32767, not 40000"), ("velocity:", "word_order")],
            ),
        ],
    )
    def test_are_told_with_their_line(self, tmp_path, replaced, expected):
        text = (DESCRIPTIONS / "kinco_fd5p.yaml").read_text()
        for before, after in replaced.items():
            text = text.replace(before, after)
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        with pytest.raises(ConfigurationError) as error:
            load_description(str(path), None, DESCRIPTIONS, ModbusDescription)
        lines = text.splitlines()
        told = [(lines[each.line - 1], each.message) for each in error.value.problems if each.line]
        for line, words in expected:
            assert any(line in shown and words in message for shown, message in told), told

    def test_32_bits_may_bring_their_own_order(self):
        wide = {name: {**each, "word_order": "little"} for name, each in SIGNALS.items() if each.get("type") == "int32"}
        assert described(wide, word_order=None).field("position").word_order == "little"


class TestOptions:
    @pytest.mark.parametrize(
        ("unit", "port", "is_right"),
        [(0, "/dev/x", False), (248, "/dev/x", False), (256, TCP, False), (255, TCP, True)],  # 255: the device itself
    )
    def test_units_that_exist(self, unit, port, is_right):
        given = {"line": {"port": port}, "description": "x", "unit": unit}
        if is_right:
            assert ModbusOptions.model_validate(given).address == f"unit {unit}"
            return
        with pytest.raises(ValidationError, match="unit"):
            ModbusOptions.model_validate(given)


class TestReady:
    @pytest.mark.parametrize("name", sorted(ready(DESCRIPTIONS)))
    def test_can_be_driven(self, name):
        description = load_description(name, None, DESCRIPTIONS, ModbusDescription)
        line, image = on_line(description)
        for mode in description.modes.values():
            plan = planned(description, mode.commands)
            read = {signal for part in (plan.poll, plan.background) for exchange in part for signal in exchange.reads}
            assert read >= {"position", "status"}
            assert {s for part in (plan.poll, plan.push) for e in part for s in e.writes} == set(mode.commands)
        for steps in description.sequences.values():
            for step in steps:
                image.values.update(step.write)
                assert line.write("a", tuple(step.write)).encode()

    def test_families(self):
        assert set(ready(DESCRIPTIONS)) >= {"kinco_fd5p", "ezmotion_mms7", "nanotec_n5", "generic_cia402"}
        with pytest.raises(UsageError, match="kinco_fd5p"):
            load_description("kinco", None, DESCRIPTIONS, ModbusDescription)

    def test_velocity_of_kinco_is_that_of_its_manual(self):
        # "4E 82 00 1B": 1789570 is 100 rpm with 65536 counts a revolution
        signal = load_description("kinco_fd5p", None, DESCRIPTIONS, ModbusDescription).signals["velocity"]
        assert 1789570 * signal.scale / 65536 * 60 == pytest.approx(100.0, rel=1e-6)


class TestPlan:
    @pytest.mark.parametrize(
        ("changed", "keys", "poll", "background"),
        [
            ({}, {}, ["read 6 registers at 0010h"], ["read 1 register at 0018h"]),
            ({}, {"max_gap_registers": 1}, ["read 6 registers at 0010h"], ["read 1 register at 0018h"]),
            ({}, {"max_gap_registers": 2}, ["read 9 registers at 0010h"], []),
            (
                {"velocity": {"address": 0x15, "type": "int32", "unit": "count/s"}, "error": {"address": 0x14}},
                {},
                ["read 7 registers at 0010h"],  # what is slow joins what is fast
                [],
            ),
            (
                {},
                {"max_read_registers": 4},
                ["read 4 registers at 0012h"],  # and does not cost a poll
                ["read 2 registers at 0010h", "read 1 register at 0018h"],
            ),
        ],
    )
    def test_what_lies_side_by_side_goes_together(self, changed, keys, poll, background):
        assert labels(planned(described(changed, **keys), CSP)) == [poll, background, ["write 3 registers at 0030h"]]

    def test_function_23_writes_while_it_reads(self):
        plan = planned(described(read_write_multiple=True), CSP)
        assert labels(plan)[0] == ["write 3 registers at 0030h and read 6 registers at 0010h"]
        assert not plan.push
        assert plan.poll[0].writes == CSP

    def test_function_23_is_for_holding_registers(self):
        inputs = {name: SIGNALS[name] | {"function": "input"} for name in (*FAST, *SLOW)}
        poll, _, push = labels(planned(described(inputs, read_write_multiple=True)))
        assert poll == ["read 6 input registers at 0010h"]
        assert push == ["write 1 register at 0030h"]
        inputs.pop("position")
        poll, _, push = labels(planned(described(inputs, read_write_multiple=True)))
        assert poll[0] == "write 1 register at 0030h and read 2 registers at 0012h"
        assert all(part.startswith("read") for part in poll[1:])
        assert not push

    def test_listening_writes_nothing(self):
        plan = planned(described(read_write_multiple=True), ())
        assert labels(plan) == [["read 6 registers at 0010h"], ["read 1 register at 0018h"], []]

    def test_aligned_access(self):
        changed = {
            "position_command": {"address": 0x34, "type": "int32", "unit": "count"},
            "torque": {"address": 0x17, "unit": "N m"},
        }
        line, image = on_line(described(changed, alignment=2, write_functions=[16]))
        image.values.update(torque_command=5.0)
        request = line.write("a", ("torque_command",))
        assert request.encode()[:-2] == bytes.fromhex("01 10 00 30 00 02 04 00 05 00 00")
        assert line.read("a", ("torque",)).label == "read 2 registers at 0016h of unit 1"

    def test_signals_far_apart_need_several_requests(self):
        line, _ = on_line(described())
        with pytest.raises(ValueError, match=r"one request cannot read status, error: .*0010h; .*0018h"):
            line.read("a", ("status", "error"))
        with pytest.raises(ValueError, match="one request cannot write"):
            line.write("a", ("control", "torque_command"))

    def test_silence(self):
        assert on_line(described())[0].silence_chars == 3.5
        # ten bits at 9600 baud take 1.04 ms
        assert on_line(described(silence_s=0.01), baud=9600)[0].silence_chars == pytest.approx(9.6)
        assert on_line(described(silence_s=0.01), TCP)[0].silence_chars == 0.0


def slave(memory):
    """Answer functions 3, 6, 16 and 23 from registers of memory, in the plainest way; CRCs are left out."""

    def answer(frame):
        unit, function, address, count = struct.unpack_from(">BBHH", frame)
        if function in (6, 16):
            words = [count] if function == 6 else struct.unpack_from(f">{count}H", frame, 7)
            memory.update(enumerate(words, address))
            return frame[:6]
        if function == 23:
            to, written = struct.unpack_from(">HH", frame, 6)
            memory.update(enumerate(struct.unpack_from(f">{written}H", frame, 11), to))
        words = [memory.get(address + k, 0xDEAD) for k in range(count)]
        return struct.pack(f">BBB{count}H", unit, function, 2 * count, *words)

    return answer


def exchange(request, memory, most):
    sent = request.encode()
    assert len(sent) == request.request_size
    assert with_crc(sent[:-2]) == sent
    counts = [1 if sent[1] == 6 else int.from_bytes(sent[4:6], "big")]
    counts += [int.from_bytes(sent[8:10], "big")] if sent[1] == 23 else []
    assert max(counts) <= most
    reply = bytearray(with_crc(slave(memory)(sent)))
    assert len(reply) == request.reply_size
    assert request.take(reply)
    assert not reply


@st.composite
def maps(draw):
    """Signals anywhere near each other in a random order, with room between them or none."""
    widths = {"int16": 1, "uint16": 1, "int32": 2, "uint32": 2}
    changed: dict[str, object] = {}
    address = draw(st.integers(0, 0x40))
    for name in draw(st.permutations(list(SIGNALS))):
        # torques and velocities have a sign
        kinds = list(widths) if name in ("position", "status", "error", "control") else ["int16", "int32"]
        kind = draw(st.sampled_from(kinds))
        signal = {"address": address, "type": kind, "byte_order": draw(st.sampled_from(["big", "little"]))}
        changed[name] = signal | {"unit": SIGNALS[name].get("unit", "")}
        address += widths[kind] + draw(st.integers(0, 4))
    most = draw(st.integers(2, 12))
    return described(
        changed,
        word_order=draw(st.sampled_from(["big", "little"])),
        max_gap_registers=draw(st.integers(0, 5)),
        max_read_registers=most,
        max_write_registers=most,
        read_write_multiple=draw(st.booleans()),
        modes={"csp": {"commands": CSP}},
    )


@settings(deadline=None)
@given(description=maps(), seed=st.integers(0, 2**32 - 1))
def test_a_planned_cycle_moves_the_same_numbers_as_single_requests(description, seed):
    line, image = on_line(description)
    most = description.max_read_registers
    random = Random(seed)
    memory = {address: random.randrange(0x10000) for address in range(0x100)}
    needed = (*FAST, *SLOW)
    single: dict[str, float] = {}
    for name in needed:
        exchange(line.read("a", (name,)), memory, most)
        single[name] = image.values[name]
    image.values.clear()
    plan = line.plan({"a": CycleSignals(FAST, SLOW, CSP)})
    commands = {name: float(random.randrange(2**15)) for name in CSP}
    image.values.update(commands)
    before = dict(memory)
    for request in (*plan.poll, *plan.background, *plan.push):
        assert isinstance(request, ModbusExchange)
        exchange(request, memory, most)
    assert image.values == single | commands
    polled = [name for request in plan.poll for name in request.reads]
    assert set(polled) >= set(FAST)
    assert len(polled) == len(set(polled))
    touched = {address for address in memory if memory[address] != before[address]}
    fields = [description.field(name) for name in CSP]
    assert touched <= {address for field in fields for address in range(field.address, field.end)}
    for name in CSP:
        exchange(line.read("a", (name,)), memory, most)
        assert image.values[name] == commands[name]


@settings(deadline=None)
@given(description=maps())
def test_a_plan_has_no_more_requests_than_single_ones(description):
    plan = planned(description, CSP)
    assert len(plan.poll) + len(plan.push) <= len(FAST) + len(CSP)
    alone = description.model_copy(update={"max_read_registers": 125, "max_gap_registers": 120})
    assert len(planned(alone).background) == 0
