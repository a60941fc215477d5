"""Tables of a drive in the robot file."""

from typing import Annotated

from pydantic import Field, model_validator

from drive_profiles.files.toml import Table


class Switches(Table):
    """Positions of an axis' switches.

    They are angles of the joint, that is of the motor divided by the reduction ratio.

    A switch without a position does not exist, and its input stays off. The index pulse comes once per motor revolution.

    Attributes:
        negative_limit_deg: Limit switch, active from here downwards.
        positive_limit_deg: Limit switch, active from here upwards.
        home_deg: Home switch, active between these two.
        index_deg: Angle of the motor at which its encoder gives the index pulse.
        probe_1_deg: Range of the joint within which touch probe 1 is active.
        probe_2_deg: The same of touch probe 2.
    """

    negative_limit_deg: float | None = None
    positive_limit_deg: float | None = None
    home_deg: tuple[float, float] | None = None
    index_deg: Annotated[float, Field(ge=0.0, lt=360.0)] = 0.0
    probe_1_deg: tuple[float, float] | None = None
    probe_2_deg: tuple[float, float] | None = None

    @model_validator(mode="after")
    def _in_order(self) -> "Switches":
        ranges = {"home_deg": self.home_deg, "probe_1_deg": self.probe_1_deg, "probe_2_deg": self.probe_2_deg}
        if self.negative_limit_deg is not None and self.positive_limit_deg is not None:
            ranges["negative_limit_deg to positive_limit_deg"] = (self.negative_limit_deg, self.positive_limit_deg)
        for name, limits_deg in ranges.items():
            if limits_deg is not None and not limits_deg[0] < limits_deg[1]:
                raise ValueError(f"{name} goes from {limits_deg[0]:g} to {limits_deg[1]:g}: the first must be the lower")
        return self


class Behaviour(Table):
    """Differences of this drive from an ideal one without delays.

    Real drives show them. All are off unless given.

    Attributes:
        tpdo_delay_us: Delay of the TPDOs after their cause (a SYNC, an event).
        tpdo_jitter_us: Up to so much is added to each of these delays, drawn from the robot's seed.
        sdo_delay_ms: Delay of an SDO answer.
        transition_delay_ms: Duration of a transition of the state machine.
        halt_blocks_mode_change: A new mode is not taken while the halt bit is set.
        quick_stop_ends_disabled_at_once: Quick stop leads to switch on disabled, also with 605Ah from 5 to 8.
        pp_handshake_cycles: SYNCs after which a set-point of profile position is acknowledged.
        needs_mode_to_enable: Without a mode of operation (6060h = 0) it does not enable, but reports emergency 6320h.
        operational_at_boot: The node goes to NMT state operational by itself.
        unconfigured: It has left the factory without a node-ID, and does nothing but LSS until a master gives it one (CiA 305).
        bus_off_restart_ms: Time from bus-off until its controller restarts by itself; left out, it stays off until the fault or
            its supply is over.
    """

    tpdo_delay_us: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    tpdo_jitter_us: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    sdo_delay_ms: Annotated[float, Field(ge=0.0, le=10e3)] = 0.0
    transition_delay_ms: Annotated[float, Field(ge=0.0, le=10e3)] = 0.0
    halt_blocks_mode_change: bool = False
    quick_stop_ends_disabled_at_once: bool = False
    pp_handshake_cycles: Annotated[int, Field(ge=0, le=1000)] = 0
    needs_mode_to_enable: bool = False
    operational_at_boot: bool = False
    unconfigured: bool = False
    bus_off_restart_ms: Annotated[float, Field(ge=0.0, le=60e3)] | None = None

    @property
    def delays_frames(self) -> bool:
        """True if any frame leaves the node later than its cause."""
        return bool(self.tpdo_delay_us or self.tpdo_jitter_us or self.sdo_delay_ms)

    @property
    def given(self) -> dict[str, float | bool]:
        """The keys that differ from their defaults."""
        return self.model_dump(exclude_defaults=True)
