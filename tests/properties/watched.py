"""A world under watch: every frame and every control period is judged by oracles that know the standard, not the code."""

import math
from collections import Counter, defaultdict

from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test

from drive_profiles.standard.cia402 import Object
from hil.can.frame import Frame
from plant_emulator.motion import record
from plant_emulator.robots.robot import SDO_DOWNLOAD_BYTES
from plant_emulator.slave.dictionary import ResetKind
from plant_emulator.world import World
from tests.properties.power_oracle import POWERED, PowerOracle, state_shown
from tests.properties.sdo_oracle import SdoOracle

MS = 1_000_000
FINE_NS = 20 * MS
"""So long a wait goes control period by control period; a longer one is looked at every millisecond."""

NOT_CONFIGURED = 0xFF
PRE_OPERATIONAL, OPERATIONAL, STOPPED = 127, 5, 4
INITIALISING = 0
_COMMANDS = {1: OPERATIONAL, 2: STOPPED, 128: PRE_OPERATIONAL, 129: PRE_OPERATIONAL, 130: PRE_OPERATIONAL}
_RESETS = {129, 130}
_FAILS_TO = {(OPERATIONAL, 0): PRE_OPERATIONAL, (OPERATIONAL, 2): STOPPED, (PRE_OPERATIONAL, 2): STOPPED}
"""Where a communication error leads, by NMT state and 1029h:01h; else nothing changes."""
MOST_ANSWERS = 127 + 64
"""Frames: the segments of one sub-block, and what a node sends of its own besides."""
LSS_REQUEST, LSS_ANSWER, SDO_REQUEST, SDO_ANSWER, ERROR_CONTROL = 0x7E5, 0x7E4, 0x600, 0x580, 0x700
CHANNEL_REQUEST, CHANNEL_ANSWER = 0x6A0, 0x6C0
"""Of the additional SDO channel that a master may open here."""

REACHED = defaultdict(Counter)
"""By machine, in how many of its runs each state has been seen: else nobody knows how deep they lead."""


class NodeWatch:
    """The promises of one node's communication.

    Args:
        port: The node-ID that it has from its robot file.
        slave: The node.
        store_ns: How long it stores.
        is_delayed: Whether its SDO answers come late; then they are not counted.
        autostart: Whether it becomes operational by itself.
    """

    def __init__(self, port, slave, store_ns=0, *, is_delayed=False, autostart=False):
        self.port, self.slave = port, slave
        self.state = INITIALISING
        self.number = slave.node_id
        self.resets = 0
        self.after_boot_up = OPERATIONAL if autostart else PRE_OPERATIONAL
        self.visited = set()

        def exists(index, subindex):
            return (index, subindex) in slave.dictionary

        self.sdos = {} if is_delayed else {channel: SdoOracle(exists, store_ns) for channel in ("predefined", "additional")}
        self._open = set()

    @property
    def node_id(self):
        return self.slave.node_id

    def _ids(self, channel):
        """Identifiers of a channel's requests and answers; None where the channel does not exist."""
        if channel == "predefined":
            return SDO_REQUEST + self.number, SDO_ANSWER + self.number
        get = self.slave.dictionary.get_int
        pair = [get(0x1201, 1), get(0x1201, 2)] if (0x1201, 1) in self.slave.dictionary else [1 << 31] * 2
        return None if any(cob_id >> 31 for cob_id in pair) else (pair[0] & 0x7FF, pair[1] & 0x7FF)

    def powered_on(self, frames):
        """Judge what the node sends when power has come."""
        self._was_reset(frames)

    def heard(self, frame, frames, now):
        """Judge the node's answers to a frame."""
        can_id, data = frame
        before, number = self.state, self.number
        if before == INITIALISING:
            if self.node_id == number:
                assert all(f.can_id == LSS_ANSWER for f in frames), (frame, frames)
            else:  # an LSS master has given it a node-ID
                self._was_reset(frames)
            return
        if can_id == 0 and len(data) == 2 and data[1] in {0, number} and data[0] in _COMMANDS:
            if data[0] in _RESETS:
                self._was_reset(frames)
                return
            self.state = _COMMANDS[data[0]]
        self._look(before, frames)
        to_lss = sum(f.can_id == LSS_ANSWER for f in frames)
        assert to_lss <= (can_id == LSS_REQUEST and before != OPERATIONAL), (frame, frames)
        for channel, sdo in self.sdos.items():
            ids = self._ids(channel)
            if ids is None or before == STOPPED:
                sdo.reset()
                continue
            answers = [f.data for f in frames if f.can_id == ids[1]]
            if can_id == ids[0] and channel in self._open:
                sdo.take(data, answers, now)
            else:
                assert not answers, (frame, frames)
        self._note_channels()

    def passed(self, frames, now):
        """Judge what the node has sent by itself."""
        before = self.state
        if before == INITIALISING:
            assert not frames, frames
            return
        self._look(before, frames)
        for channel, sdo in self.sdos.items():
            ids = self._ids(channel) if frames else None
            sdo.passed([] if ids is None else [f.data for f in frames if f.can_id == ids[1]], now)

    def _was_reset(self, frames):
        """One boot-up message, before anything else."""
        self.resets += 1
        self.number = self.node_id
        for sdo in self.sdos.values():
            sdo.reset()
        if self.number == NOT_CONFIGURED:
            self.state = INITIALISING
            assert not frames, frames
            return
        self.state = self.after_boot_up
        boot_up = ERROR_CONTROL + self.number, b"\0"
        assert [tuple(f) for f in frames].count(boot_up) == 1, frames
        assert tuple(frames[0]) == boot_up, frames
        self.visited.add(self.state)
        self._note_channels()

    def _note_channels(self):
        self._open = {channel for channel in self.sdos if self._ids(channel) is not None}

    def _look(self, before, frames):
        """The NMT state is what the commands have made of it, but for a failure that 1029h answers.

        Stopped, a node sends nothing but error control and LSS; a boot-up message belongs to a reset alone.
        """
        state = self.slave.nmt_state.value
        if state != self.state:
            causes = self.slave.emergencies.causes
            assert any("heartbeat" in c or "guarding" in c for c in causes), (self.state, state, causes)
            self.failed()
        for frame in frames:
            if frame.can_id == ERROR_CONTROL + self.number:
                assert frame.data[0] & 0x7F in {before, state} - {INITIALISING}, (before, state, frames)
            elif before == state == STOPPED:
                assert frame.can_id == LSS_ANSWER, frames
        if state == STOPPED:
            for sdo in self.sdos.values():
                sdo.reset()
        self.visited.add(state)

    def failed(self):
        """Judge where a communication error has led: where 1029h says."""
        behaviour, state = self.slave.dictionary.get_int(0x1029, 1), self.slave.nmt_state.value
        assert state == _FAILS_TO.get((self.state, behaviour), self.state), (self.state, behaviour, state)
        self.state = state
        if state == STOPPED:
            for sdo in self.sdos.values():
                sdo.reset()

    def judge_memory(self):
        """What others can make the node keep has an end."""
        slave = self.slave
        channels = slave._sdo.servers
        assert len(channels) <= 2
        assert all(server.buffered_bytes <= SDO_DOWNLOAD_BYTES + 7 * 127 for server in channels.values())
        assert len(slave.emergencies._waiting) <= 8
        assert len(slave.emergencies._history) <= 8
        assert len(slave.emergencies._active) <= 64
        assert len(slave.dictionary.stored) <= len(slave.dictionary)
        for queue in (getattr(slave, "_tpdos", None), getattr(slave, "_answers", None)):
            assert queue is None or len(queue.frames) <= 1024


class DriveWatch:
    """The promises of one drive's state machine, brake and torque."""

    def __init__(self, world, number, node):
        self.world, self.node = world, node
        self.drive = drive = world.drives[number]
        self.axis = world.robot.axis[number]
        self.is_ours = self.axis.profile == "emulated_drive"
        self.motion, self.plant = world.axes.motion[drive.row], world.axes.plant_state[drive.row]
        behaviour = self.axis.behaviour
        is_exact = not (behaviour.transition_delay_ms or behaviour.quick_stop_ends_disabled_at_once)
        self.power = PowerOracle(drive.state.name, is_exact=is_exact)
        self.was_operational = False
        self.visited, self.modes = {drive.state.name}, set()
        self.torque_ticks = self.slope_ticks = 0
        self._last, self._was_braked = None, False
        self._period_s = world.robot.control_period_s
        cell = drive.slave.dictionary.cell(Object.CONTROL_WORD)
        self._act, cell.write_hook = cell.write_hook, self._word
        self._reset, drive.slave.on_reset = drive.slave.on_reset, self._on_reset
        self._get = drive.slave.dictionary.get_int

    def _word(self, word):
        before = self.drive.state.name
        self.power.judge_itself(before)
        code = self._act(word)
        after = self.drive.state.name
        self.power.judge_word(
            word,
            before,
            after,
            quick_stop=self._get(0x605A),
            shutdown=self._get(0x605B),
            disable=self._get(0x605C),
            has_voltage=not self.drive.inputs.is_sto_active,
            may_energise=self.drive.slave.nmt_state.value == OPERATIONAL,
        )
        return code

    def _on_reset(self, kind):
        self._reset(kind)
        if kind is ResetKind.NODE:
            self.was_operational, self._last = False, None
            self.power.reset(self.drive.state.name)

    def judge(self):
        """After each frame and each look: the state, what the status word shows of it, and whether there may be torque."""
        state = self.drive.state.name
        self.power.judge_itself(state)
        self.visited.add(state)
        self.was_operational = self.was_operational or self.drive.slave.nmt_state.value == OPERATIONAL
        has_torque = self.motion["mode"] != record.BRAKED
        if has_torque:
            self._was_braked = False
            self.modes.add((self._get(0x6061), int(self.motion["mode"])))
        else:
            self._last = None  # enabled anew within a control period, the slope begins at 0
        if has_torque or self.motion["torque_nm"] != 0.0:
            assert state in POWERED, state
            assert self.was_operational
        assert state_shown(self._get(0x6041)) == state

    def judge_tick(self):
        """After a control period: the torque within its limits and its slope, and every number a number."""
        motion, plant = self.motion, self.plant
        torque, mode = float(motion["torque_nm"]), int(motion["mode"])
        if mode == record.BRAKED:
            assert torque == 0.0
            # in the period in which the brake closes the motor still has what was asked of it before
            assert plant["torque_nm"] == 0.0 or not self._was_braked
            self._last, self._was_braked = None, True
            return
        self._was_braked = False
        self.torque_ticks += 1
        assert math.isfinite(torque)
        assert math.isfinite(
            plant["motor_angle_rad"] + plant["motor_speed_rad_s"] + plant["arm_angle_rad"] + plant["arm_speed_rad_s"]
        )
        low, high = self._limits()
        slack = 1e-9 * self.axis.torque_limit_nm
        assert low - slack <= torque <= high + slack, (low, torque, high)
        if not self.axis.current_time_constant_s:
            assert low - slack <= plant["torque_nm"] <= high + slack
        last, self._last = self._last, (mode, torque)
        if self.is_ours and mode == record.PROFILE_TORQUE and last is not None and last[0] == mode:
            self.slope_ticks += 1
            change = max(1, self._get(0x6087)) * self._quantum_nm * self._period_s + slack
            least, most = (min(high, max(low, last[1] + way)) for way in (-change, change))
            assert least - slack <= torque <= most + slack, (last, torque, change)

    @property
    def is_awake(self):
        """Whether the drive has something to do while time passes."""
        return self.drive.needs_update or self.motion["mode"] != record.BRAKED

    def skip_tick(self):
        """Time has passed unseen: no slope is known."""
        self._last = None

    @property
    def _quantum_nm(self):
        return 1e-6 * self._get(0x6076)

    def _limits(self):
        """6072h, 6073h, 60E0h, 60E1h and the motor's own."""
        motor = self.axis.torque_limit_nm
        if not self.is_ours:
            return -motor, motor
        get = self._get
        rated_ma = get(0x6075)  # without one 6073h is a part of nothing, and limits nothing
        current_nm = 1e-6 * get(0x6073) * rated_ma * self.axis.torque_constant_nm_a if rated_ma else math.inf
        most = min(motor, get(0x6072) * self._quantum_nm, current_nm)
        return -min(most, get(0x60E1) * self._quantum_nm), min(most, get(0x60E0) * self._quantum_nm)


class WatchedWorld:
    """A bus with its nodes and a master that is under no obligation to be sensible."""

    def __init__(self, robot, **options):
        self.world = world = World(robot, **options)
        self.nodes = {}
        for number, drive in world.drives.items():
            behaviour = robot.axis[number].behaviour
            self.nodes[drive.node_id] = NodeWatch(
                drive.node_id,
                drive.slave,
                drive.slave.store.time_ns,
                is_delayed=bool(behaviour.sdo_delay_ms),
                autostart=behaviour.operational_at_boot,
            )
        sensor = world.accelerometer
        self.nodes[sensor.node_id] = NodeWatch(sensor.node_id, sensor.slave)
        self.drives = {n: DriveWatch(world, n, self.nodes[d.node_id]) for n, d in world.drives.items()}

    def power_on(self):
        frames = self.world.power_on()
        for node in self.nodes.values():
            node.powered_on([f for f in frames if f.can_id & 0x7F == node.node_id])
        self.judge()

    def power_cycle(self, port):
        """A loss of power, where the world can tell the node by a number that no other node has."""
        node = self.nodes[port]
        name = port if node.number == NOT_CONFIGURED else node.number
        if all(each.number != name for each in self.nodes.values() if each is not node):
            node.powered_on(self.world.power_cycle(name))
            self.judge()

    def send(self, can_id, data=b""):
        """A frame, and every node's answers judged; what all of them answered."""
        frame = Frame(can_id, bytes(data))
        heard = self.world.hear(frame)
        assert len(heard) <= MOST_ANSWERS, frame
        for port, node in self.nodes.items():
            node.heard(frame, [answer for of, answer in heard if of == port], self.world.now)
        self.judge()
        return [answer for _, answer in heard]

    def wait(self, nanoseconds):
        """Let time pass, control period by control period where it is short."""
        world = self.world
        until = world.now + nanoseconds
        tick_ns = world._control_period_ns
        is_fine = nanoseconds <= FINE_NS
        while world.now < until:
            if is_fine:
                step = tick_ns - world.now % tick_ns
            else:
                step = MS if any(drive.is_awake for drive in self.drives.values()) else 50 * MS
            due = world.due
            before = world.now // tick_ns
            sent = world.move(min(until, world.now + step, until if due is None else due))
            ticks = world.now // tick_ns - before
            if sent or due is not None or not is_fine:
                for port, node in self.nodes.items():
                    node.passed([frame for of, frame in sent if of == port], world.now)
            for drive in self.drives.values():
                if ticks == 1:
                    drive.judge_tick()
                elif ticks:
                    drive.skip_tick()
                    drive.judge_tick()
                drive.judge()

    def judge(self):
        """Judge every drive as it stands."""
        for drive in self.drives.values():
            drive.judge()

    @property
    def reached(self):
        """What has been seen at least once: states of drives and nodes, modes under torque, states of SDO servers."""
        found = {f"NMT {state}" for node in self.nodes.values() for state in node.visited}
        found |= {f"SDO {state}" for node in self.nodes.values() for sdo in node.sdos.values() for state in sdo.visited}
        for drive in self.drives.values():
            found |= {f"state {state}" for state in drive.visited}
            found |= {f"mode {mode} law {each}" for mode, each in drive.modes}
        return found

    def judge_memory(self):
        for node in self.nodes.values():
            node.judge_memory()
        assert len(self.world._listeners) <= 2048


def run_for(machine, *, examples, steps):
    """Play a machine's rules, so many runs of so many steps."""
    options = settings(max_examples=examples, stateful_step_count=steps, suppress_health_check=list(HealthCheck))
    run_state_machine_as_test(machine, settings=options)
