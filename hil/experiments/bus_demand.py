"""Bus load of a motion between two SYNCs, and its check."""

from dataclasses import dataclass

from drive_profiles.family.profile import Profile
from hil.bench.bench import Bench
from hil.can.channel import Channel
from hil.control.treatments import LoopName
from hil.errors import NotPossibleError
from hil.master.drive.mapping import CSP, mode_of


@dataclass(frozen=True)
class BusDemand:
    """Frames that a motion needs in every cycle.

    Attributes:
        with_notch: True if the drives' variable filters act; they report their state where there is room.
        with_torque_offset: True if a torque offset (60B2h) is sent beside each position.
    """

    title: str
    axes: tuple[int, ...]
    period_s: float
    loop: LoopName = "drive"
    with_notch: bool = False
    with_torque_offset: bool = False


def check_load(bench: Bench, channel: Channel, demand: BusDemand) -> bool:
    """Refuse a motion whose frames do not fit between two SYNCs.

    Without a known bit rate nothing is checked.

    Returns:
        True if there is room for the state of the drives' filters as well.

    Raises:
        NotPossibleError: The frames do not fit.
    """
    if channel.address.bitrate is None:
        return True
    from hil.plan.check import check  # noqa: PLC0415 - a bus without bit times does not need it

    where = bench.on(str(channel.address))
    for shows_filter in (True, False) if demand.with_notch and demand.loop == "drive" else (False,):
        verdict = check(
            where, demand.axes, demand.loop, demand.period_s, notch_state=shows_filter, with_notch=demand.with_notch,
            torque_offset=demand.with_torque_offset,
        )  # fmt: skip
        if verdict.fits is not False:
            return shows_filter
    period = f"a SYNC period of {1e3 * demand.period_s:g} ms"
    raise NotPossibleError(
        f"{demand.title} at {period}: {verdict.sentence} --overload runs it nevertheless",
        ("bus load",),
    )


def takes_torque_offset(profile: Profile) -> bool:
    """True if drives of a family add a torque offset (60B2h)."""
    capabilities = profile.capabilities
    if mode_of("drive", profile) is not CSP:
        return False
    return capabilities is not None and capabilities.torque_offset.answer in {"exact", "yes"}
