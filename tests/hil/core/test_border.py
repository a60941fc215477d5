"""Arrays that C cannot take are refused at the border, and no number that comes through it ends the process."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.control.cancellation import CANCELLATION_CONFIG, CANCELLATION_STATE, WAVE_COLUMNS
from hil.control.cascade import Cascade
from hil.control.notch import NOTCH_CONFIG, Notch
from hil.control.servo import LAW, Servo, ServoConfig
from hil.control.servo_bank import ServoBank
from hil.core.library import CORE

CONFIG = ServoConfig(Cascade(25.0, 0.1, 1.0), 2.0, (Notch(),))
ANY = st.one_of(
    st.sampled_from([0.0, -0.0, math.nan, math.inf, -math.inf, 5e-324, -2.2e-308, 1.8e308, 9e18, -9.3e18, 1e300]),
    st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True),
)


@pytest.mark.parametrize(
    ("array", "name", "said"),
    [
        (np.zeros(3, np.float32), "double", "array of float32 where double is expected"),
        (np.zeros(3, np.int64), "double", "array of int64 where double is expected"),
        (np.zeros(1, NOTCH_CONFIG), "law", "where law is expected"),
        (np.zeros(1, LAW), "notch_config", "where notch_config is expected"),
        (
            np.zeros((4, 4))[:, ::2],
            "double",
            r"array of shape \(4, 2\) is read-only or not contiguous; give a contiguous copy of it",
        ),
        (np.zeros((4, 4)).T[1:], "double", "not contiguous"),
    ],
)
def test_an_array_that_c_cannot_take_is_refused(array, name, said):
    with pytest.raises(ValueError, match=said):
        CORE.pointer(array, name)


def test_a_read_only_array_is_refused():
    array = np.zeros(3)
    array.flags.writeable = False
    with pytest.raises(ValueError, match="read-only"):
        CORE.pointer(array)


def test_a_record_of_an_array_is_taken_as_it_lies_there():
    rows = np.zeros(3, LAW)
    CORE.call.servo_start(CORE.pointer(rows[1], "law"), 0.5, 1.0, 0.25)
    assert rows["cascade_state"]["motor_angle_rad"].tolist() == [0.0, 0.5, 0.0]


def test_a_row_that_is_not_there_is_refused():
    bank = ServoBank([CONFIG] * 2, 250e-6)
    for row in (2, -3, 10**9):
        with pytest.raises(IndexError):
            bank.step_one(row, 0.0, 0.0)


def test_arguments_that_are_no_numbers_are_refused():
    law = Servo(CONFIG, 250e-6)
    for value in ("1", None, [1.0], 1j):
        with pytest.raises(TypeError):
            law.step(value, 0.0)


@pytest.mark.parametrize("period_s", [0.0, -1e-3, math.nan])
def test_a_period_that_is_none_is_refused(period_s):
    for made in (Servo, lambda config, period: ServoBank([config], period)):
        with pytest.raises(ValueError, match=r"period_s = .* must be above 0"):
            made(CONFIG, period_s)


@given(st.lists(st.tuples(ANY, ANY, ANY, ANY), min_size=1, max_size=8))
@settings(max_examples=300)
def test_any_number_goes_through_the_law(rows):
    law = Servo(CONFIG, 250e-6)
    law.start(*rows[0][:3])
    for row in rows:
        assert isinstance(law.step(*row), float)


@pytest.mark.ci
@given(st.lists(st.tuples(ANY, ANY), min_size=1, max_size=8), ANY, ANY)
@settings(max_examples=300)
def test_any_number_goes_through_the_cancellation(rows, step_rps, lowpass_hz):
    configs, states = np.zeros(1, CANCELLATION_CONFIG), np.zeros(1, CANCELLATION_STATE)
    configs["step_rps"], configs["speed_lowpass_hz"], configs["torque_step_nm"] = step_rps, lowpass_hz, 0.01
    waves, table, values = np.ones((1, 2, 3)), np.ones((1, 2, 4, WAVE_COLUMNS)), np.zeros((2, 1))
    shared, given = CORE.new("cancellation"), [CORE.pointer(each) for each in (waves, table)]
    shared.configs, shared.states = CORE.pointer(configs, "cancellation_config"), CORE.pointer(states, "cancellation_state")
    shared.waves, shared.table = given
    shared.count, shared.wave_count, shared.speeds, shared.period_s = 1, 2, 4, 1e-3
    for row in rows:
        values[:, 0] = row
        CORE.call.cancel(shared, CORE.pointer(values))


@pytest.mark.ci
@given(st.lists(st.tuples(st.integers(0, 3), st.binary(max_size=8)), max_size=8), st.binary(max_size=64), st.booleans())
@settings(max_examples=300)
def test_any_bytes_go_through_the_taking_of_answers(frames, message, is_whole):
    axes, joints = np.zeros(1, CORE.dtype("axis_data")), np.zeros(1, CORE.dtype("joint_data"))
    answers, exchange = np.zeros(4, CORE.dtype("answer")), CORE.new("exchange")
    answers["content"] = range(4)
    kept = [CORE.pointer(axes, "axis_data"), CORE.pointer(joints, "joint_data"), CORE.pointer(answers, "answer")]
    exchange.axes, exchange.joints, exchange.answers = kept
    exchange.axis_count, exchange.joint_count, exchange.answer_count = 1, 1, 4
    CORE.call.await_answers(exchange)
    message = b"".join(bytes(4) + message[i : i + 1] + message[i : i + 11].ljust(11) for i in range(4)) if is_whole else message
    CORE.call.take_message(exchange, message, len(message))
    for which, data in frames:
        CORE.call.take_answer(exchange, which, data, len(data))
    CORE.call.count_answers(exchange)
    assert exchange.missing_answers == exchange.pending == 4 - np.count_nonzero(answers["has_come"])


@given(st.binary(max_size=400), st.integers(0, 5))
@settings(max_examples=300)
def test_any_bytes_go_through_the_reader_of_logs_within_their_room(text, room):
    buffer = np.frombuffer(bytearray(text), np.uint8)
    kept = [np.full(room + 2, 77, kind) for kind in (np.int64, np.int64, np.uint8, np.uint64)]
    names = ("int64_t", "int64_t", "uint8_t", "uint64_t")
    arrays, counters = [CORE.pointer(each, name) for each, name in zip(kept, names, strict=True)], np.zeros(7, np.int64)
    found = CORE.call.parse_candump(
        CORE.pointer(buffer, "uint8_t"), len(buffer), *arrays, room, CORE.pointer(counters, "int64_t")
    )
    assert 0 <= found <= room
    assert all((each[room + 1 :] == 77).all() for each in kept)
