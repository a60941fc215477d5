"""An emulated drive of every profile: who it is, what it holds, refuses and stores, and that its filter acts."""

import math

import numpy as np
import pytest
from scipy import signal

from drive_profiles.family.capability import Abort
from drive_profiles.family.profile import Profile
from drive_profiles.realisation import held_filter
from drive_profiles.realisation.sections import obstacles
from drive_profiles.standard.cia301 import DataType, SdoAbortCode, encode
from drive_profiles.standard.cia402 import Mode, Object, State
from drive_profiles.standard.object_address import object_address
from hil.control.notch import NOTCH_FIXED, NOTCH_STATE, NOTCHES
from hil.robot_tables import Control
from plant_emulator.drive.family.objects import ENGINE, stated_default
from plant_emulator.robots.robot import load_robot, with_drives
from plant_emulator.slave.store import VOLATILE
from tests.drive_profiles.profiles import ALL_DRIVES
from tests.hil.control.law_in_c import notch_step
from tests.plant_emulator.rig import GAINS, Rig

AXIS = 2
VENDORS = sorted(set(ALL_DRIVES) - {"emulated_drive"})
ROBOT = load_robot("reference")
GAINS_2 = Control(position_gain_per_s=25.0, velocity_gain_nm_s_rad=0.196, velocity_integral_gain_nm_rad=3.92)
BEYOND = {SdoAbortCode.VALUE_TOO_HIGH, SdoAbortCode.VALUE_TOO_LOW, SdoAbortCode.INVALID_VALUE}


def rig_of(name, **changes):
    """A rig on axis 2 of the reference robot, which such a drive moves."""
    robot = with_drives(ROBOT, {AXIS: name})
    axis = robot.axis[AXIS].model_copy(update=changes)
    return Rig(robot.model_copy(update={"axis": {AXIS: axis}, "geometry": None, "line_motion": None}), AXIS)


@pytest.fixture(params=sorted(ALL_DRIVES))
def rig(request):
    return rig_of(request.param)


@pytest.fixture
def profile(rig):
    return ALL_DRIVES[rig.drive.family.profile]


def cell(rig, parameter):
    return rig.drive.slave.dictionary.cell(*parameter.address)


def stated(rig, profile):
    """The parameters in which the profile's word counts: not the commands, and not what the engine works by."""
    commands = {command.address for command in rig.drive.family.store_commands}
    for name, parameter in profile.parameters.items():
        if parameter.address not in commands and parameter.index not in ENGINE:
            yield name, parameter


def of_the_motor(rig, profile):
    """Objects that hold the motor's own values, whatever the factory's."""
    facts = (profile.torque.rated_torque, profile.encoder.increments, profile.encoder.revolutions,
             profile.encoder.gear_motor_revs, profile.encoder.gear_shaft_revs)  # fmt: skip
    return {object_address(address) for address in facts if address is not None}


def limits_of(parameter, scaling):
    per_step = None if parameter.is_bytes else parameter.value_per_step(scaling)
    for bound, low in ((parameter.minimum, True), (parameter.maximum, False)):
        if bound is not None and parameter.data_type != "BOOLEAN":
            yield low, bound / per_step


# -- who it is and what it holds ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_it_says_who_it_is(rig, profile):
    identity = profile.identity
    assert rig.read(0x1018, 1) == identity.vendor_id
    assert rig.read(0x1018, 2) == (identity.product_code or 0)
    assert rig.read(0x1018, 3) == identity.typical_revision
    assert identity.covers(rig.read(0x1018, 3))
    assert rig.read(0x1018, 4) == AXIS
    assert rig.read(0x1000) == (identity.device_type or 0x00020192)
    assert rig.upload(0x1008).decode("latin-1")


def test_it_serves_every_parameter_with_the_profiles_type_and_access(rig, profile):
    for name, parameter in profile.parameters.items():
        held, entry = rig.upload(*parameter.address), cell(rig, parameter).entry
        if parameter.access == "wo":
            assert held == SdoAbortCode.WRITE_ONLY, name
        else:
            assert isinstance(held, bytes), f"{name}: {held:08X}h"
        if parameter.index not in ENGINE:
            assert entry.data_type is DataType[parameter.data_type], name
            assert entry.access.is_writable == (parameter.access != "ro"), name
            assert parameter.type.size in {None, len(held) if isinstance(held, bytes) else parameter.type.size}, name


@pytest.mark.ci
def test_a_parameter_holds_the_profiles_default_but_for_the_motors_own(rig, profile):
    checked = 0
    if rig.drive.family.profile == "emulated_drive":
        pytest.skip("its defaults are the motor's, see test_data_sheets")
    for name, parameter in stated(rig, profile):
        default = stated_default(parameter)
        if default is not None and parameter.address not in of_the_motor(rig, profile) and parameter.access != "wo":
            assert rig.upload(*parameter.address) == encode(parameter.type, default), name
            checked += 1
    assert checked or not any(p.default is not None for _, p in stated(rig, profile))


def test_what_the_profile_calls_read_only_is_refused(rig, profile):
    for name, parameter in stated(rig, profile):
        if parameter.access == "ro":
            data = bytes(parameter.type.size or 1)
            assert rig.download(*parameter.address, data) == SdoAbortCode.READ_ONLY, name


def test_a_value_beyond_the_profiles_limits_is_refused_and_changes_nothing(rig, profile):
    scaling = rig.drive.scaling
    for name, parameter in stated(rig, profile):
        if parameter.access == "ro" or parameter.address in of_the_motor(rig, profile):
            continue
        for low, limit in limits_of(parameter, scaling):
            step = max(1e-3, 1e-3 * abs(limit)) if parameter.type.is_real else 1
            beyond = (-step if low else step) + (limit if parameter.type.is_real else round(limit))
            try:
                data = encode(parameter.type, beyond)
            except ValueError:
                continue  # the type itself ends there
            before = rig.upload(*parameter.address)
            assert rig.download(*parameter.address, data) in BEYOND, f"{name}: {beyond}"
            assert rig.upload(*parameter.address) == before


def test_the_motors_own_objects_agree_with_the_axis(rig, profile):
    axis, scaling = ROBOT.axis[AXIS], rig.drive.scaling
    torque, encoder = profile.torque, profile.encoder
    if torque.rated_torque is not None:
        held = int.from_bytes(rig.upload(*object_address(torque.rated_torque)), "little")
        assert held * torque.rated_torque_step_nm == pytest.approx(axis.rated_torque, abs=torque.rated_torque_step_nm)
        assert scaling.rated_torque_nm == pytest.approx(held * torque.rated_torque_step_nm)
    if encoder.increments is not None:
        held = int.from_bytes(rig.upload(*object_address(encoder.increments)), "little")
        assert held == scaling.encoder_counts_per_rev
        # halved where the drive's object cannot state as many
        assert axis.encoder_counts_per_rev % held == 0
    elif encoder.counts_per_rev is not None:
        assert scaling.encoder_counts_per_rev == encoder.counts_per_rev
    assert rig.motion["counts_per_rad"] == scaling.counts_per_rad


# -- store -------------------------------------------------------------------------------------------------------------


def another_value(parameter, entry, held):
    """A value that differs from what is held and that the limits allow, or None where there is none."""
    if entry.data_type.size is None:
        return None
    low = entry.low if entry.low is not None else held
    high = entry.high if entry.high is not None else held
    for value in (low, high, held + 1, held - 1):
        if value != held and entry.refusal(value) is None:
            try:
                encode(entry.data_type, value)
            except ValueError:
                continue
            return float(value) if entry.data_type.is_real else int(value)
    return None


def test_what_is_stored_survives_a_loss_of_power_and_restoring_brings_the_factory_back(rig, profile):
    store, factory, written = profile.store, {}, {}
    for name, parameter in stated(rig, profile):
        entry = cell(rig, parameter).entry
        untouchable = parameter.index < 0x2000 or parameter.index in VOLATILE or parameter.address in of_the_motor(rig, profile)
        if untouchable or parameter.access != "rw" or entry.data_type is DataType.BOOLEAN:
            continue
        held = cell(rig, parameter).current()
        value = another_value(parameter, entry, held)
        if value is not None and rig.download(*parameter.address, encode(entry.data_type, value)) is None:
            factory[name], written[name] = encode(entry.data_type, held), rig.upload(*parameter.address)
    assert written
    if store.object is None:
        rig.power_cycle()
        assert {name: rig.upload(*profile.parameters[name].address) for name in factory} == factory
        return
    signature = store.signature.to_bytes(4, "little")
    began = rig.world.now
    assert rig.save(*object_address(store.object), signature) is None
    assert rig.world.now - began <= 1e9 * store.wait_s + 1e7
    rig.power_cycle()
    assert {name: rig.upload(*profile.parameters[name].address) for name in written} == written
    if store.restore is not None:
        assert rig.save(*object_address(store.restore), store.restore_signature.to_bytes(4, "little")) is None
        assert {name: rig.upload(*profile.parameters[name].address) for name in written} == written
        rig.power_cycle()
        assert {name: rig.upload(*profile.parameters[name].address) for name in factory} == factory


def test_there_is_no_store_object_where_the_profile_knows_none(rig, profile):
    has_one = profile.store.object is not None
    answer = rig.upload(*object_address(profile.store.object)) if has_one else rig.upload(0x1010, 1)
    assert answer == (b"\1\0\0\0" if has_one else SdoAbortCode.NO_OBJECT)


# -- states, and when a parameter may be written -----------------------------------------------------------------------


def able(name):
    """A rig whose drive can be enabled in cyclic torque, which needs no gains; None where the drive has not the mode."""
    rig = rig_of(name, control=GAINS)
    return rig if Mode.CST in rig.drive.family.modes else None


@pytest.mark.parametrize("name", VENDORS)
def test_a_mode_that_the_profile_does_not_state_is_refused(name):
    rig = rig_of(name)
    for mode in (Mode.PP, Mode.CSP, Mode.CST):
        expected = None if mode in ALL_DRIVES[name].supported_modes else SdoAbortCode.INVALID_VALUE
        assert rig.write(Object.MODES_OF_OPERATION, 0, mode) is expected
    assert rig.read(Object.SUPPORTED_MODES) == sum(1 << (mode - 1) for mode in rig.drive.family.modes)


@pytest.mark.parametrize("name", VENDORS)
def test_an_enabled_drive_refuses_what_may_only_be_written_while_disabled_and_does_not_store(name):
    rig, profile = able(name), ALL_DRIVES[name]
    if rig is None:
        pytest.skip("no cyclic torque")
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 1, -(2**31))
    rig.enable(Mode.CST)
    refusal = next((abort.code for abort in profile.aborts if "state" in abort.text.lower()), SdoAbortCode.DEVICE_STATE)
    for parameter_name, parameter in stated(rig, profile):
        if parameter.effective == "disabled" and parameter.access == "rw" and parameter.type.size:
            held = rig.upload(*parameter.address)
            assert rig.download(*parameter.address, held) == refusal, parameter_name
    if profile.store.object is not None:
        place = object_address(profile.store.object)
        assert rig.save(*place, profile.store.signature.to_bytes(4, "little")) == SdoAbortCode.DEVICE_STATE
    assert rig.drive.state is State.OPERATION_ENABLED


# -- gains and filters -------------------------------------------------------------------------------------------------


@pytest.mark.ci
@pytest.mark.parametrize("name", VENDORS)
def test_the_robot_files_gains_are_in_the_objects_whose_scaling_is_known_and_act(name):
    rig, loop = rig_of(name, control=GAINS), ALL_DRIVES[name].loop
    config = rig.world.axes.cascade_config[rig.drive.row]
    for role in ("position_gain_per_s", "velocity_gain_nm_s_rad", "velocity_integral_gain_nm_rad"):
        parameter = ALL_DRIVES[name].parameters.get(loop.gains[role].parameter) if role in loop.gains else None
        coarse = 0.0
        if parameter is not None and loop.gains[role].factor is not None:
            coarse = (
                0.0 if parameter.type.is_real else 0.5 * loop.gains[role].factor * parameter.value_per_step(rig.drive.scaling)
            )
        clipped = parameter is not None and parameter.maximum is not None
        if not clipped:
            assert config[role] == pytest.approx(
                getattr(GAINS, role), rel=1e-3 if "time_s" not in loop.gains else 0.1, abs=coarse
            )


def realisable(name):
    profile = ALL_DRIVES[name]
    answer = profile.capabilities.notch_inside.answer
    if profile.notch is None or profile.notch.form == "variable" or answer not in {"exact", "yes", "approximate"}:
        return False
    return not any(obstacles(profile, profile.notch, section) for section in profile.notch.sections)


def filter_values(profile):
    """Raw values of a filter at 12 Hz, by parameter name, as far as this form takes them."""
    notch, values = profile.notch, {}
    section = notch.sections[0]
    rule = signal.bilinear([1, 2 * 0.05 * 75, 75**2], [1, 2 * 0.4 * 75, 75**2], fs=4000.0)
    b, a = rule
    wanted = {
        "zero_frequency": 12.0, "pole_frequency": 12.5, "frequency": 60.0, "zero_damping": 0.05, "zero_q": 5.0,
        "pole_damping": 0.4, "pole_q": 1.25, "damping": 0.5, "q": 1.0, "bandwidth": 20.0, "gain": 1.0,
        "b0": b[0], "b1": b[1], "b2": b[2], "b3": 0.0, "b4": 0.0,
        "a1": -notch.a_sign * a[1], "a2": -notch.a_sign * a[2], "a3": 0.0, "a4": 0.0,
    }  # fmt: skip
    for part, name in section.parts.items():
        values[name] = wanted[part]
    return values | dict(section.settings)


@pytest.mark.parametrize("name", [name for name in VENDORS if realisable(name)])
def test_an_uploaded_filter_changes_the_torque_as_its_biquads_say(name):
    rig, profile = rig_of(name, control=GAINS), ALL_DRIVES[name]
    values = filter_values(profile)
    for parameter_name, value in sorted(values.items(), key=lambda item: profile.parameter(item[0]).order):
        parameter = profile.parameter(parameter_name)
        raw = parameter.raw(value, rig.drive.scaling)
        assert rig.download(*parameter.address, encode(parameter.type, raw)) is None, parameter_name
    if any(profile.parameter(each).effective == "reset" for each in values):
        rig.save(*object_address(profile.store.object), profile.store.signature.to_bytes(4, "little"))
        rig.power_cycle()
    section = profile.notch.sections[0]
    alone = profile.model_copy(update={"notch": profile.notch.model_copy(update={"sections": (section,)})})
    held = {n: profile.parameter(n).decoded(rig.upload(*profile.parameter(n).address), rig.drive.scaling) for n in values}
    assert {n: pytest.approx(held[n], rel=1e-2, abs=1e-2) for n in values} == values
    sections = held_filter(alone, held, ROBOT.control_period_s)
    assert sections, "the filter of the test is not active"
    config = rig.world.axes.notch_config[rig.drive.row]
    assert [row["mode"] == NOTCH_FIXED for row in config] == [n < len(sections) for n in range(NOTCHES)]
    # the law itself, with the arrays that the drive has set, against scipy
    state = np.zeros(NOTCHES, NOTCH_STATE)
    u = np.concatenate((np.zeros(3), np.random.default_rng(1).standard_normal(500)))
    got = []
    for sample in u:
        y = sample
        for column in range(NOTCHES):
            y = notch_step(config[column], state[column], ROBOT.control_period_s, 0.0, y)
        got.append(y)
    want = u
    for each in sections[:NOTCHES]:
        want = signal.lfilter(each[:3], (1.0, *each[3:]), want)
    np.testing.assert_allclose(got, want, atol=1e-9 * max(1.0, np.abs(want).max()))
    assert not math.isclose(float(np.std(want)), float(np.std(u)), rel_tol=1e-6)


def test_a_filter_whose_scaling_nobody_knows_stays_off_and_the_drive_says_so():
    names = [
        name for name in VENDORS
        if ALL_DRIVES[name].notch is not None and ALL_DRIVES[name].notch.word == "integer, scaling not known"
    ]  # fmt: skip
    assert names
    for name in names:
        rig = rig_of(name)
        assert not rig.world.axes.notch_config[rig.drive.row]["mode"].any()


@pytest.mark.parametrize("name", [name for name in VENDORS if realisable(name)])
def test_a_filter_of_which_a_value_is_not_known_does_not_act(name):
    rig, profile = rig_of(name), ALL_DRIVES[name]
    parts = profile.notch.sections[0].parts.values()
    if all(profile.parameter(part).default is not None for part in parts):
        pytest.skip("all are known")
    assert not rig.world.axes.notch_config[rig.drive.row]["mode"].any()


@pytest.mark.parametrize("name", [n for n in VENDORS if realisable(n) and Mode.CSP in ALL_DRIVES[n].supported_modes])
def test_an_axis_with_an_uploaded_filter_holds_and_moves(name):
    rig, profile = rig_of(name, control=GAINS_2), ALL_DRIVES[name]
    for parameter_name, value in filter_values(profile).items():
        parameter = profile.parameter(parameter_name)
        assert rig.download(*parameter.address, encode(parameter.type, parameter.raw(value, rig.drive.scaling))) is None
    rig.set(Object.FOLLOWING_ERROR_WINDOW, 0, 2**32 - 1)
    rig.set(Object.MAX_TORQUE, 0, 3000)
    rig.set(Object.INTERPOLATION_PERIOD, 1, 2)
    rig.set(Object.INTERPOLATION_PERIOD, 2, -3)
    rig.cyclic(Mode.CSP)
    rig.turn(1.0, 0.5)
    assert rig.notch_state["active"][0] == 1
    assert rig.drive.state is State.OPERATION_ENABLED
    assert rig.speed_rps == pytest.approx(1.0, abs=0.3)


# -- what no profile of the package has today --------------------------------------------------------------------------


@pytest.fixture
def changed(monkeypatch):
    """A drive whose gains act after a reset or may only be written while disabled, and that says so with a code of its own."""
    profile = ALL_DRIVES["novanta_eve"]
    loop, known = profile.loop, {}
    for effective, (role, gain) in zip(("reset", "disabled"), loop.gains.items(), strict=False):
        known[effective] = gain.parameter
        loop = loop.model_copy(update={"gains": {**loop.gains, role: gain.model_copy(update={"factor": 2.0})}})
    parameters = dict(profile.parameters)
    for effective, name in known.items():
        parameters[name] = parameters[name].model_copy(update={"effective": effective})
    own = Abort(code=0x0800_0FFF, text="Not in this state of the device: drive enabled", source="a test", evidence="definition")
    update = {
        "parameters": parameters,
        "loop": loop,
        "aborts": (own,),
        "modes": profile.modes.model_copy(update={"names": ("CST",)}),
    }
    profile = profile.model_copy(update=update)
    monkeypatch.setattr(Profile, "load", lambda _: profile)
    return rig_of("novanta_eve"), profile, {effective: profile.parameter(name) for effective, name in known.items()}


def test_a_gain_that_acts_after_a_reset_acts_when_it_has_been_stored_and_the_node_was_reset(changed):
    rig, profile, parameters = changed
    role = next(role for role, gain in profile.loop.gains.items() if profile.parameter(gain.parameter) == parameters["reset"])
    config = rig.world.axes.cascade_config[rig.drive.row]
    factory = float(config[role])
    raw = encode(parameters["reset"].type, parameters["reset"].raw(0.5))
    assert rig.download(*parameters["reset"].address, raw) is None
    assert rig.upload(*parameters["reset"].address) == raw
    assert config[role] == factory != pytest.approx(1.0)
    rig.nmt(0x81)
    assert config[role] == factory  # not stored, so lost
    assert rig.download(*parameters["reset"].address, raw) is None
    assert rig.save(*object_address(profile.store.object)) is None
    assert config[role] == factory
    rig.nmt(0x81)
    assert config[role] == pytest.approx(1.0)


def test_a_drive_with_an_abort_code_of_its_own_for_the_wrong_state_uses_it(changed):
    rig, _, parameters = changed
    held = rig.upload(*parameters["disabled"].address)
    assert rig.download(*parameters["disabled"].address, held) is None
    rig.enable(Mode.CST)
    assert rig.download(*parameters["disabled"].address, held) == 0x0800_0FFF
    rig.word(0x06)
    assert rig.download(*parameters["disabled"].address, held) is None
