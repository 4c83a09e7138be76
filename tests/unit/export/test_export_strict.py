"""Programs for languages without NaN do what Python does with it: the flags beside numbers stand for it."""

import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.export import kernels
from friction_hil.export.ir import Variable
from friction_hil.export.st_printer import TYPES, Declared, StPrinter, field_name
from friction_hil.export.strict import strict
from friction_hil.export.translator import Translator
from friction_hil.export.values import State, StateRecord
from tests.structured_text import Program

FIELDS = [("last", "f8"), ("kept", "f8"), ("history", "f8", (4,))]


def _extremes(s, x, y):
    least = min(x, y)
    largest = max(y, x, s.kept)
    s.kept = y
    return least + 10.0 * largest


def _comparisons(s, x, y):
    s.last = s.last + (1.0 if x < y else 0.0) + (2.0 if x != y else 0.0) + (4.0 if not x >= y else 0.0)
    if math.isfinite(x) and x > s.last:
        s.last = x
    elif math.isnan(y) or y == x:
        s.last = s.last - 1.0
    return s.last


def _kept(s, x, y):
    before = s.kept
    s.kept = x if math.isfinite(x) else y
    return before


def _passed_on(s, x, y):
    return _kept(s, y, x) + 1.0 if s.last == 0.0 or math.isnan(x) else _kept(s, 2.0, x)


def _reassigned(s, x, y):
    total = 0.0
    for k in range(4):
        if not math.isfinite(y):
            break
        x = 0.5 * x
        s.history[k] = x
        total = total + (s.history[3] if k == 2 else abs(x))
    return total


def _guarded(s, x, y):
    index = int(y) if math.isfinite(y) else -1
    if index < 4 and index >= 0 and s.history[index] >= 0.0:
        s.history[index] = x
    return s.history[(index - 1) & 3] + s.history[((index - 5) // 2) & 3]


def _divided(s, x, y):
    ratio = x / y if y != 0.0 else 0.0
    return ratio + math.copysign(1.0, ratio) if math.isfinite(ratio) and ratio != 0.0 else -7.0


KERNELS = (_extremes, _comparisons, _kept, _passed_on, _reassigned, _guarded, _divided)


@cache
def of(kernel):
    """A kernel as a function in Structured Text, compiled for the tests, and its strict program."""
    state = State(np.zeros(1, FIELDS))
    inputs = (Variable("real", "x"), Variable("real", "y"))
    for _ in range(3):
        state.forget_use()
        translator = Translator(state, kernels.INTRINSICS, kernels.DEFINITIONS, kernels.PASSES)
        entry, _ = translator.function(kernel, [StateRecord(), *inputs], "run")
    operands = tuple(translator.operands(entry, kernel, [StateRecord(), *inputs]))
    made = kernels.Program(entry, operands, inputs, tuple(kernels.called(entry)), state, ())
    program = strict(made, ("x", "y"))
    printer = StPrinter("a", "b", (), ())
    kinds = [(one, TYPES[one.type]) for one in program.fields]
    fields = [
        Declared(field_name(one.name), f"ARRAY[0..{len(one.initial) - 1}] OF {kind}" if one.is_array else kind)
        for one, kind in kinds
    ]
    inner = "\n".join(each.text() for each in fields)
    structure = f"TYPE a_b_state :\nSTRUCT\n{inner}\nEND_STRUCT;\nEND_TYPE\n" if fields else ""
    whole = Program(structure + "\n".join(printer.function(each).text() for each in program.functions))
    return whole, program


def runner(kernel):
    whole, program = of(kernel)
    own = []
    if program.fields:
        own = [whole.structure("a_b_state")]
        for one in program.fields:
            values = [bool(each) if one.type == "bool" else each for each in one.initial]
            setattr(own[0], field_name(one.name), values if one.is_array else values[0])
    names = [each.name for each in program.inputs]

    def run(**given):
        flags = {f"{name}_known": not math.isnan(value) for name, value in given.items()}
        plain = {name: 0.0 if math.isnan(value) else value for name, value in given.items()}
        result = whole.function("a_b_run")(*own, *((plain | flags)[name] for name in names))
        value, is_known = result if isinstance(result, tuple) else (result, True)
        return value if is_known else math.nan

    return run


NUMBERS = st.sampled_from([math.nan, -1.0, 0.0, 0.25, 1.0, 2.0, 3.0, 7.0])


@pytest.mark.parametrize("kernel", KERNELS)
@settings(max_examples=60, deadline=None)
@given(rows=st.lists(st.tuples(NUMBERS, NUMBERS), max_size=6))
def test_unknown_numbers_do_what_nan_does(kernel, rows):
    run, state = runner(kernel), SimpleNamespace(last=0.0, kept=0.0, history=[0.0] * 4)
    for x, y in rows:
        wanted, got = kernel(state, x, y), run(x=x, y=y)
        assert got == wanted or (math.isnan(got) and math.isnan(wanted)), (x, y)
