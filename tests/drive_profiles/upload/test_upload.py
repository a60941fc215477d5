"""The upload transaction against emulated drives of every family, in the robot's own time."""

import pytest

from drive_profiles.errors import DriveProfileError, NodeError, RefusedError
from drive_profiles.family.profile import Profile
from drive_profiles.parameter_set.commands import is_command
from drive_profiles.parameter_set.parameters import Item, ParameterSet
from drive_profiles.standard.cia402 import State
from drive_profiles.upload import fleet, journal
from drive_profiles.upload.interrupt import InterruptWindow
from drive_profiles.upload.journal import as_set
from drive_profiles.upload.result import UploadOptions
from drive_profiles.upload.upload import Upload
from plant_emulator.drive.state_machine import Power
from tests.drive_profiles.profiles import ALL_DRIVES
from tests.drive_profiles.world_bus import WorldBus, robot_with


def changed(pulled, **values):
    """The set with other values of its tuning parameters."""
    names = {name.replace("__", "."): value for name, value in values.items()}
    table = {
        name: item.model_copy(update={"value": names[name]}) if name in names else item for name, item in pulled.tuning.items()
    }
    assert set(names) <= set(table)
    return pulled.model_copy(update={"tuning": table})


def upload(device, parameter_set, tmp_path, **options):
    made = Upload(device, parameter_set, UploadOptions(journals=tmp_path / "journals", **options))
    fleet.prepare([made])
    return fleet.run([made])[0]


@pytest.fixture
def bus():
    return WorldBus(robot_with())


NOTCH = {"notch_1__mode": 1, "notch_1__start_rps": 4.5, "position_gain_per_s": 25.0}


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL_DRIVES)
def test_pull_change_upload_back_leaves_no_difference(name, tmp_path):
    bus = WorldBus(robot_with(axis2={"profile": name}))
    device = bus.device(2, name)
    pulled = device.pull()
    assert not pulled.header.not_read
    assert sum(1 for _ in pulled.items()) == sum(
        1 for e in device.catalogue if e.is_readable and e.is_writable and not is_command(e.address, Profile.load(name))
    )
    assert upload(device, pulled, tmp_path, allow_unverified=True).written == 0
    moved = _moved(pulled, device)
    outcome = upload(device, moved, tmp_path, allow_unverified=True)
    assert (outcome.kind, outcome.written > 0) == ("done", True), outcome
    assert device.pull().differences(moved) == []
    back = upload(device, pulled, tmp_path, allow_unverified=True, store=Profile.load(name).store.object is not None)
    assert back.kind == "done", back
    assert device.pull().differences(pulled) == []
    assert device.pull().digest() == pulled.digest()


def _moved(pulled, device):
    """Every gain, filter value and limit that can be moved by one step, moved; encoder and gear are what the axis is."""
    return pulled.model_copy(update={name: _moved_table(getattr(pulled, name), device) for name in ("tuning", "limits")})


OPTION_CODES, HALT_OPTION = (0x6007, *range(0x605A, 0x605F)), 0x605D


def _moved_table(table, device):
    moved = dict(table)
    for key, item in table.items():
        entry = device.catalogue.find(key)
        if entry.parameter is None or isinstance(item.value, str) or item.type is not None:
            continue
        scaling = device.scaling([entry])
        step = 0.5 if entry.parameter.type.is_real else entry.parameter.value_per_step(scaling)
        higher, lower = item.value + step, item.value - step
        # an option code has few values, from 0 on; that of halt from 1
        is_high = entry.parameter.index in OPTION_CODES and item.value > (entry.parameter.index == HALT_OPTION)
        for value in (lower, higher) if is_high else (higher, lower):
            try:
                held = entry.encoded(value, scaling)
            except DriveProfileError:
                continue
            moved[key] = item.model_copy(update={"value": entry.decoded(held, scaling)})
            break
    return moved


def test_a_second_upload_writes_nothing_and_leaves_no_journal(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    wanted = changed(device.pull(), **NOTCH)
    first = upload(device, wanted, tmp_path)
    assert (first.kind, first.written) == ("done", 3)
    dictionary = bus.world.drives[2].slave.dictionary
    dictionary.wrap_write(0x2100, 1, lambda own: lambda value: pytest.fail("written again"))
    second = upload(device, wanted, tmp_path)
    assert (second.kind, second.written, second.journal) == ("done", 0, None)


def test_uploaded_and_stored_values_survive_a_loss_of_power_and_others_do_not(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    wanted = changed(device.pull(), **NOTCH)
    assert upload(device, wanted, tmp_path, store=True).stored == "yes"
    later = changed(wanted, position_gain_per_s=11.0)
    assert upload(device, later, tmp_path).stored == "no"
    assert device.pull().differences(later) == []
    device.reset(5.0)
    assert device.pull().differences(wanted) == []


def test_reset_after_the_store_checks_what_the_drive_has_kept(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    outcome = upload(device, changed(device.pull(), **NOTCH), tmp_path, store=True, reset=True)
    assert (outcome.kind, outcome.stored) == ("done", "yes")
    wanted = changed(device.pull(), position_gain_per_s=12.0)
    dictionary = bus.world.drives[2].slave.dictionary
    keep = dictionary.reset

    def forgetful(kind):
        dictionary.stored = {place: value for place, value in dictionary.stored.items() if place != (0x2100, 1)}
        keep(kind)

    dictionary.reset = forgetful
    outcome = upload(device, wanted, tmp_path, store=True, reset=True)
    assert outcome.kind == "unknown"
    assert "position_gain_per_s" in outcome.unknown[0]


def test_a_store_that_the_drive_refuses_leaves_everything_as_it_was(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    before = device.pull()
    bus.world.drives[2].slave.store.fails = True
    outcome = upload(device, changed(before, **NOTCH), tmp_path, store=True)
    assert outcome.kind == "unknown"  # a memory that fails may hold anything
    assert [text.split(" ")[0] for text in outcome.unknown] == ["1010:1"]
    assert device.pull().differences(before) == []
    assert outcome.exit_code == 6


def test_a_store_that_takes_longer_than_the_profile_says_is_unknown_not_done(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    bus.world.drives[2].slave.store.time_ns = 30_000_000_000
    outcome = upload(device, changed(device.pull(), **NOTCH), tmp_path, store=True)
    assert (outcome.kind, outcome.stored) == ("unknown", "unknown")
    assert "1010:1" in outcome.unknown[0]


def test_a_slow_store_within_the_profiles_time_is_waited_for(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    bus.world.drives[2].slave.store.time_ns = 1_500_000_000
    outcome = upload(device, changed(device.pull(), **NOTCH), tmp_path, store=True)
    assert (outcome.kind, outcome.stored) == ("done", "yes")


def test_an_enabled_drive_is_not_written_to(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    wanted = changed(device.pull(), **NOTCH)
    bus.world.drives[2]._set_power(Power(State.OPERATION_ENABLED))
    with pytest.raises(NodeError, match=r"operation enabled.*disable it first"):
        upload(device, wanted, tmp_path)
    assert not (tmp_path / "journals").exists()


def test_a_drive_that_is_enabled_meanwhile_does_not_store(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    drive = bus.world.drives[2]
    made = Upload(device, changed(device.pull(), **NOTCH), UploadOptions(journals=tmp_path, store=True))
    fleet.prepare([made])
    before = made.verify

    def verify_then_enable(*arguments):
        before(*arguments)
        drive._set_power(Power(State.OPERATION_ENABLED))

    made.verify = verify_then_enable
    [outcome] = fleet.run([made])
    assert outcome.stored == "no"
    assert outcome.kind in {"rolled back", "unknown"}  # an enabled drive refuses its gains
    assert not drive.slave.store.stored


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ({"vendor_id": 0x123}, "vendor is 0x48494C01, the parameter set says 0x123"),
        ({"product_code": 0x999}, "product is 0x402, the parameter set says 0x999"),
    ],
)
def test_a_set_of_another_device_is_refused(bus, tmp_path, header, words):
    device = bus.device(2, "emulated_drive")
    pulled = device.pull()
    other = pulled.model_copy(update={"header": pulled.header.model_copy(update=header)})
    with pytest.raises(NodeError, match=words):
        upload(device, other, tmp_path)


def test_a_profile_of_another_drive_is_refused(bus, tmp_path):
    device = bus.device(2, "nanotec_cl4e")
    with pytest.raises(NodeError, match=r"vendor .* profile nanotec_cl4e says 0x26C"):
        upload(device, ParameterSet(), tmp_path)


def test_every_line_that_cannot_be_written_is_named_and_nothing_is_sent(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    lines = {
        "position_gain_per_s": Item(value=20000.0, unit="1/s"),
        "lowpass_hz": Item(value=300.0, unit="rad/s"),
        "notch_1.frequency_hz": Item(value=1.0, unit="Hz"),
        "nothing_like_it": Item(value=1),
        "0x6040": Item(value=15, type="UNSIGNED16"),
    }
    with pytest.raises(RefusedError) as caught:
        upload(device, ParameterSet(tuning=lines), tmp_path)
    assert len(caught.value.reasons) == 5
    for key in lines:
        assert any(reason.startswith(key) for reason in caught.value.reasons)


def test_commissioning_values_go_back_to_their_own_device_only(bus, tmp_path):
    own, other = bus.device(2, "emulated_drive"), bus.device(3, "emulated_drive")
    header = own.pull().header
    offsets = ParameterSet(header=header, commissioning={"0x6065": Item(value=1000, type="UNSIGNED32")})
    with pytest.raises(RefusedError, match="commissioning values of another device"):
        upload(other, offsets, tmp_path)
    assert upload(own, offsets, tmp_path).kind == "done"
    assert upload(other, offsets, tmp_path, force_commissioning=True).kind == "done"


def test_facts_that_nobody_has_verified_are_not_written_unless_asked(tmp_path):
    bus = WorldBus(robot_with(axis2={"profile": "kollmorgen_akd"}))
    device = bus.device(2, "kollmorgen_akd")
    pulled = device.pull()
    with pytest.raises(DriveProfileError, match="allow-unverified"):
        upload(device, pulled, tmp_path)
    assert upload(device, pulled, tmp_path, allow_unverified=True).kind == "done"


def test_several_drives_all_or_none(bus, tmp_path):
    devices = [bus.device(node, "emulated_drive") for node in (2, 3, 5)]
    before = [device.pull() for device in devices]
    uploads = [
        Upload(device, changed(pulled, **NOTCH), UploadOptions(journals=tmp_path / "j", store=True))
        for device, pulled in zip(devices, before, strict=True)
    ]
    fleet.prepare(uploads)
    bus.world.drives[3].slave.dictionary.wrap_write(0x2110, 3, lambda own: lambda value: 0x0609_0030)
    outcomes = fleet.run(uploads)
    assert [outcome.kind for outcome in outcomes] == ["rolled back"] * 3
    assert all(outcome.exit_code == 6 for outcome in outcomes)
    assert "2110h:3 (notch_1.start_rps)" in outcomes[1].reason
    assert "another drive failed" in outcomes[0].reason
    for device, pulled in zip(devices, before, strict=True):
        assert device.pull().differences(pulled) == []
        assert not bus.world.drives[device.node].slave.store.stored


def test_when_one_of_several_drives_cannot_store_the_others_store_their_old_values_again(bus, tmp_path):
    devices = [bus.device(node, "emulated_drive") for node in (2, 3)]
    before = [device.pull() for device in devices]
    uploads = [
        Upload(device, changed(pulled, **NOTCH), UploadOptions(journals=tmp_path / "j", store=True))
        for device, pulled in zip(devices, before, strict=True)
    ]
    fleet.prepare(uploads)
    bus.world.drives[3].slave.store.may_store = lambda: 0x0800_0022
    first, second = fleet.run(uploads)
    assert (first.kind, first.stored) == ("rolled back", "again")
    assert (second.kind, second.stored) == ("rolled back", "no")
    assert bus.world.drives[2].slave.store.stored[0x2100, 1] == before[0].tuning["position_gain_per_s"].value


def test_three_drives_at_once_hold_what_they_shall(bus, tmp_path):
    uploads = []
    for number, node in enumerate((2, 3, 5)):
        device = bus.device(node, "emulated_drive")
        wanted = changed(device.pull(), position_gain_per_s=20.0 + number)
        uploads.append(Upload(device, wanted, UploadOptions(journals=tmp_path / "j", store=True)))
    fleet.prepare(uploads)
    assert [outcome.kind for outcome in fleet.run(uploads)] == ["done"] * 3
    for number, node in enumerate((2, 3, 5)):
        assert bus.world.drives[node].slave.dictionary.get(0x2100, 1) == 20.0 + number


def test_an_interrupted_upload_puts_everything_back(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    before = device.pull()
    made = Upload(device, changed(before, **NOTCH), UploadOptions(journals=tmp_path))
    fleet.prepare([made])
    window = InterruptWindow()
    [outcome] = fleet.run([made], fleet.UploadControl(window, lambda node, count: window.interrupt()))
    assert (outcome.kind, outcome.exit_code) == ("rolled back", 130)
    assert device.pull().differences(before) == []


def test_without_rollback_what_was_touched_is_said_to_be_unknown(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    wanted = changed(device.pull(), **NOTCH)
    bus.world.drives[2].slave.dictionary.wrap_write(0x2110, 3, lambda own: lambda value: 0x0609_0030)
    outcome = upload(device, wanted, tmp_path, rollback=False)
    assert outcome.kind == "unknown"
    assert any("notch_1.start_rps" in text for text in outcome.unknown)


def test_a_mistake_of_the_program_itself_still_puts_everything_back(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    before = device.pull()
    made = Upload(device, changed(before, **NOTCH), UploadOptions(journals=tmp_path))
    fleet.prepare([made])

    def broken(node, count):
        raise ZeroDivisionError("a bug")

    [outcome] = fleet.run([made], fleet.UploadControl(progress=broken))
    assert (outcome.kind, outcome.exit_code) == ("rolled back", 1)
    assert "ZeroDivisionError" in outcome.reason
    assert device.pull().differences(before) == []


def test_a_snapshot_goes_back_by_the_same_transaction(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    before = device.pull()
    done = upload(device, changed(before, **NOTCH), tmp_path)
    statement = journal.read(done.journal)
    assert "hold the requested values" in str(statement)
    kept = as_set(statement.snapshot, device.catalogue)
    assert upload(device, kept, tmp_path).kind == "done"
    assert device.pull().differences(before) == []


def test_limits_of_the_drive_are_refused_before_anything_is_sent_not_by_its_abort(bus, tmp_path):
    device = bus.device(2, "emulated_drive")
    wanted = changed(device.pull(), notch_1__order=9)
    sent = bus.frames
    with pytest.raises(RefusedError, match=r"notch_1\.order: 2110:2 9: is outside 1 to 8"):
        upload(device, wanted, tmp_path)
    assert bus.world.drives[2].slave.dictionary.get(0x2110, 2) == 2
    assert bus.frames - sent < 40
