"""An interrupt at every frame of an upload: exit status, sentence, journal and what the drive holds say the same."""

import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from drive_profiles.cli.console import Interrupts
from drive_profiles.cli.transact import exit_status
from drive_profiles.parameter_set.parameters import Item, ParameterSet
from drive_profiles.upload import fleet, journal
from drive_profiles.upload.interrupt import InterruptWindow
from drive_profiles.upload.result import UploadOptions, UploadResult
from drive_profiles.upload.upload import Upload
from tests.drive_profiles import upload_rig as rig
from tests.drive_profiles.world_bus import WorldBus, robot_with

GAIN = (0x2100, 1)
IN_TIME, TOO_LATE = "interrupted: it is put back", "the interrupt came too late"


class InterruptedBus(WorldBus):
    """A world whose master gets a signal at a frame that it sends or waits for."""

    def __init__(self) -> None:
        super().__init__(robot_with())
        self.steps = 0
        self.at: Callable[[int], None] = lambda step: None

    def put(self, can_id: int, data: bytes) -> None:
        self._step()
        super().put(can_id, data)
        self._step()

    def wait(self, seconds: float) -> None:
        self._step()
        super().wait(seconds)

    def _step(self) -> None:
        self.at(self.steps)
        self.steps += 1


@pytest.fixture(scope="module")
def bus() -> InterruptedBus:
    return InterruptedBus()


def gain_of(value: float) -> ParameterSet:
    return ParameterSet(tuning={"position_gain_per_s": Item(value=value, unit="1/s")})


def prepared(bus: InterruptedBus, values: dict[int, float], options: UploadOptions) -> list[Upload]:
    """Uploads of new gains to the drives of some nodes, ready to be run."""
    uploads = [Upload(bus.device(node, "emulated_drive"), gain_of(value), options) for node, value in values.items()]
    fleet.prepare(uploads)
    return uploads


def upload(bus: InterruptedBus, folder: Path, values: dict[int, float], at: int | None) -> tuple[list[UploadResult], int]:
    """Store and reset new gains, with a real signal at a step; gives the results and the number of steps."""
    options = UploadOptions(journals=folder, store=True, reset=True)
    uploads = prepared(bus, values, options)
    bus.steps = 0
    bus.at = lambda step: signal.raise_signal(signal.SIGINT) if step == at else None
    with Interrupts() as interrupts:
        interrupts.hold(IN_TIME, TOO_LATE)
        results = fleet.run(uploads, fleet.UploadControl(interrupts.window))
        bus.at = lambda step: None
    return results, bus.steps


def gain(bus: InterruptedBus, node: int) -> float:
    return bus.world.drives[node].slave.dictionary.get(*GAIN)


def after_power(bus: InterruptedBus, node: int) -> float:
    """What the drive holds once it has been reset."""
    device = bus.device(node, "emulated_drive")
    device.reset(5.0)
    return gain(bus, node)


@pytest.mark.parametrize("store", [pytest.param(False, marks=pytest.mark.ci), True])
def test_an_interrupt_at_every_frame_leaves_status_sentence_journal_and_drive_in_agreement(store, tmp_path, capfd):
    wanted = ParameterSet(tuning={"p0": Item(value=100), "p1": Item(value=101), "text": Item(value="from now on")})
    before, after, seen, at = rig.contents(rig.node()), None, [], 0
    while seen.count(0) < 12:  # as many frames behind the last point of return
        slave = rig.node()
        line = rig.Line(slave)
        made = rig.upload(slave, tmp_path / f"{at}", wanted, line, store=store)
        with Interrupts() as interrupts:
            interrupts.hold(IN_TIME, TOO_LATE)
            first = line.frames + at
            line.on_frame = lambda number, first=first: signal.raise_signal(signal.SIGINT) if number == first else None
            [outcome] = fleet.run([made], fleet.UploadControl(interrupts.window))
            line.on_frame = lambda number: None
            if line.frames <= first:  # behind its last frame
                signal.raise_signal(signal.SIGINT)
        said, status, noted = capfd.readouterr().err.strip(), exit_status([outcome]), journal.read(outcome.journal)
        after = after or {**before, (0x2000, 1): 100, (0x2001, 1): 101, (0x2100, 0): "from now on"}
        is_back = status == 130
        assert status in {0, 130}
        assert said == (IN_TIME if is_back else TOO_LATE), at
        assert outcome.kind == noted.outcome == ("rolled back" if is_back else "done"), at
        assert outcome.stored == noted.stored == ("yes" if store and not is_back else "no"), at
        assert bool(slave.store.stored) == (store and not is_back), at
        assert rig.contents(slave) == (before if is_back else after), at
        seen.append(status)
        at += 1
    assert seen == sorted(seen, reverse=True), "in time first, then too late"
    assert seen.count(130) > 12


@pytest.mark.ci
def test_an_interrupt_at_any_frame_of_an_upload_with_a_reset_agrees_with_what_the_drive_has_kept(bus, tmp_path, capfd):
    [outcome], steps = upload(bus, tmp_path, {2: 13.0}, None)
    assert outcome.kind == "done"
    seen = set()
    for at in range(0, steps, 7):
        before = gain(bus, 2)
        wanted = 13.5 if before == 20.0 else 20.0
        [outcome], _ = upload(bus, tmp_path, {2: wanted}, at)
        status = exit_status([outcome])
        seen.add(status)
        is_back = status == 130
        assert capfd.readouterr().err.strip() == (IN_TIME if is_back else TOO_LATE), at
        assert journal.read(outcome.journal).stored == ("no" if is_back else "yes"), at
        assert gain(bus, 2) == after_power(bus, 2) == (before if is_back else wanted), at
    assert seen == {0, 130}


def test_of_several_drives_an_interrupt_puts_all_back_or_none(tmp_path, capfd):
    bus = InterruptedBus()
    nodes = (2, 3)
    for at in range(0, 40, 3):
        before = {node: gain(bus, node) for node in nodes}
        wanted = {node: 13.5 if held == 20.0 else 20.0 for node, held in before.items()}
        window = InterruptWindow()
        options = UploadOptions(journals=tmp_path, store=True)
        uploads = prepared(bus, wanted, options)
        bus.steps, came = 0, []
        bus.at = lambda step, at=at, window=window, came=came: came.append(window.interrupt()) if step == at else None
        results = fleet.run(uploads, fleet.UploadControl(window))
        bus.at = lambda step: None
        is_back = came == [True]
        assert {result.kind for result in results} == ({"rolled back"} if is_back else {"done"}), at
        assert exit_status(results) == (130 if is_back else 0)
        assert {node: gain(bus, node) for node in nodes} == (before if is_back else wanted)


def test_whichever_is_first_the_interrupt_or_the_closing_decides_for_good():
    window = InterruptWindow()
    assert not window.is_interrupted
    assert window.interrupt()
    assert not window.close()
    assert window.interrupt()
    assert window.is_interrupted
    closed = InterruptWindow()
    assert closed.close()
    assert not closed.interrupt()
    assert not closed.is_interrupted


def test_an_interrupt_after_the_outcome_is_told_that_it_is_too_late(bus, tmp_path, capfd):
    with Interrupts() as interrupts:
        interrupts.hold(IN_TIME, TOO_LATE)
        options = UploadOptions(journals=tmp_path)
        made = Upload(bus.device(3, "emulated_drive"), gain_of(14.0), options)
        fleet.prepare([made])
        bus.world.drives[3].slave.dictionary.wrap_write(*GAIN, lambda own: lambda value: 0x0609_0030)
        [outcome] = fleet.run([made], fleet.UploadControl(interrupts.window))
        assert (outcome.kind, outcome.exit_code) == ("rolled back", 6), "nothing but the drive's refusal had ended it"
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
    assert capfd.readouterr().err.strip() == TOO_LATE
