"""The high-voltage amplifier: what it makes of its command.

Rise and fall are first order with their own time constants: the converter charges the film, the resistor across it
discharges it. Belongs here: the amplifier. What the voltage does in the film does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from schemas.arrays import Float


@dataclass(frozen=True)
class Amplifier:
    """Gain kV/V, time constants s (0: none), slew limit kV/s, largest voltage kV.

    `monitored`: the monitor shows what reaches the film; otherwise it shows the demand, and the lag stays hidden.
    """

    gain_kv_per_v: float = 1.5
    rise_time_constant_s: float = 0.0
    fall_time_constant_s: float = 0.0
    slew_kv_per_s: float = math.inf
    largest_kv: float = 15.0
    monitored: bool = True

    def command_for(self, voltage_kv: Float) -> Float:
        """Command in V that asks for the voltage."""
        return voltage_kv / self.gain_kv_per_v

    def amplify(self, command_v: Float, interval_s: float) -> tuple[Float, Float]:
        """What reaches the film and what the monitor shows, both (n,) in kV, for a command (n,) in V."""
        demand = np.clip(command_v * self.gain_kv_per_v, 0.0, self.largest_kv)
        film = self.follow(demand, interval_s)
        return film, film if self.monitored else demand

    def follow(self, demand_kv: Float, interval_s: float) -> Float:
        """Voltage (n,) in kV that follows the demand (n,), held between the samples; it begins settled."""
        if self.rise_time_constant_s == self.fall_time_constant_s and math.isinf(self.slew_kv_per_s):
            if self.rise_time_constant_s == 0:
                return demand_kv
            keep = math.exp(-interval_s / self.rise_time_constant_s)
            start = demand_kv[0]
            followed, _ = lfilter([0.0, 1 - keep], [1.0, -keep], demand_kv - start, zi=np.zeros(1))
            return np.asarray(start + followed)
        rise, fall = (
            1 - math.exp(-interval_s / tau) if tau else 1.0
            for tau in (self.rise_time_constant_s, self.fall_time_constant_s)
        )
        limit = self.slew_kv_per_s * interval_s
        voltage = float(demand_kv[0])
        followed_list = [voltage]
        # The two directions differ, so the recursion has no closed form; plain floats are quickest here.
        for target in demand_kv[:-1].tolist():
            change = (target - voltage) * (rise if target > voltage else fall)
            voltage += min(max(change, -limit), limit)
            followed_list.append(voltage)
        return np.asarray(followed_list)

    def towards(self, voltage_kv: float, demand_kv: float, times_s: Float) -> Float:
        """Voltage at `times_s` after a change of the demand to `demand_kv`, without slew limit."""
        tau = self.rise_time_constant_s if demand_kv > voltage_kv else self.fall_time_constant_s
        if tau == 0:
            return np.where(times_s > 0, demand_kv, voltage_kv)
        return np.asarray(demand_kv + (voltage_kv - demand_kv) * np.exp(-times_s / tau))
