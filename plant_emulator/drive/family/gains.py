"""The gains of a maker's drive."""

from collections.abc import Callable
from typing import Any

from drive_profiles.family.capability import LoopFacts
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import Value
from drive_profiles.standard.object_address import ObjectAddress
from drive_profiles.standard.units import Scaling
from plant_emulator.robots.robot import RobotAxis

DIRECT = ("position_gain_per_s", "velocity_gain_nm_s_rad", "velocity_integral_gain_nm_rad", "lowpass_hz")
INTEGRAL_TIME = "velocity_integral_time_s"


class Gains:
    """Gains of a drive, as far as its drive profile states them."""

    def __init__(self, profile: Profile, loop: LoopFacts, axis: RobotAxis, scaling: Scaling) -> None:
        self._profile, self._loop, self._scaling = profile, loop, scaling
        self._control, self._torque_constant = axis.control, axis.torque_constant_nm_a
        self._types = {parameter.address: parameter.type for parameter in profile.parameters.values()}

    def factor(self, role: str) -> tuple[ObjectAddress, float] | None:
        """Return object and step (in SI units) of a gain, or None."""
        gain = self._loop.gains.get(role)  # type: ignore[call-overload]  # a role that the profile may not have
        if gain is None or gain.factor is None:
            return None
        parameter = self._profile.parameter(gain.parameter)
        constant = self._torque_constant if gain.times_torque_constant else 1.0
        return parameter.address, parameter.value_per_step(self._scaling) * gain.factor * constant

    def factory(self) -> dict[ObjectAddress, Value]:
        """Return the robot file's gains of known scaling, in drive units."""
        control = self._control
        if control is None or self._loop.structure != "P-PI":
            return {}
        wanted = {name: float(getattr(control, name)) for name in DIRECT}
        if wanted["velocity_integral_gain_nm_rad"] > 0.0:
            wanted[INTEGRAL_TIME] = wanted["velocity_gain_nm_s_rad"] / wanted["velocity_integral_gain_nm_rad"]
        raw: dict[ObjectAddress, Value] = {}
        for role, value in wanted.items():
            factor = self.factor(role)
            if factor is not None:
                kind = self._types[factor[0]]
                raw[factor[0]] = value / factor[1] if kind.is_real else round(value / factor[1])
        return raw

    def acting(self, held: Callable[[ObjectAddress], Any]) -> dict[str, float]:
        """Return the acting gains in SI: the drive's, else the file's.

        Args:
            held: Gives the value that acts of an object.
        """
        control = self._control
        gains = dict.fromkeys(DIRECT, 0.0) | {"lowpass_hz": 300.0}
        if control is not None:
            gains |= {name: float(getattr(control, name)) for name in DIRECT}
        if self._loop.structure != "P-PI":
            return gains
        for role in (*DIRECT, INTEGRAL_TIME):
            factor = self.factor(role)
            if factor is None:
                continue
            value = float(held(factor[0])) * factor[1]
            if role == INTEGRAL_TIME:
                gains["velocity_integral_gain_nm_rad"] = gains["velocity_gain_nm_s_rad"] / value if value > 0.0 else 0.0
            elif role != "lowpass_hz" or value > 0.0:
                gains[role] = value
        return gains

    @property
    def addresses(self) -> set[ObjectAddress]:
        """Objects of all gains, with known or unknown scaling."""
        return {self._profile.parameter(gain.parameter).address for gain in self._loop.gains.values()}

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on gains without effect, and on assumptions."""
        if self._loop.structure != "P-PI":
            return ("Its gains do not act: the robot file's gains close a P-PI loop in their place.",)
        notes = []
        unknown = [role for role in DIRECT[:3] if self.factor(role) is None]
        if self.factor(INTEGRAL_TIME) is not None and DIRECT[2] in unknown:
            unknown.remove(DIRECT[2])
        if unknown:
            notes.append(f"Gains of unknown scaling: {', '.join(unknown)}. The robot file's gains act in their place.")
        if any(gain.times_torque_constant for gain in self._loop.gains.values()):
            notes.append(f"Gains in amperes act with an assumed torque constant of {self._torque_constant:g} N·m/A.")
        return tuple(notes)
