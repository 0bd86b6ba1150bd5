"""The numbers that the paper prints.

K. B. Wipke, M. R. Cuddy, S. D. Burch, "ADVISOR 2.1: A User-Friendly Advanced Powertrain Simulation Using a Combined
Backward/Forward Approach", NREL/JA-540-26839, August 1999 (preprint for IEEE Transactions on Vehicular Technology),
section III, tables 2 to 5.
"""

from __future__ import annotations

from typing import NamedTuple

SOURCE = "Wipke, Cuddy, Burch, NREL/JA-540-26839 (1999)"

#: Test masses of the three series hybrids [kg] (table 1).
MASSES = (1459, 1936, 2393)
#: The paper converts miles per hour by 0.447 instead of 0.44704.
SPEED_1999 = 0.447 / 0.44704


class Accuracy(NamedTuple):
    """Tables 2 to 4: best effort against the trace found by iteration, and the difference as printed [%]."""

    title: str
    unit: str
    rows: tuple[str, ...]
    hybrid: tuple[float, ...]
    iteration: tuple[float, ...]
    difference: tuple[float, ...]


class Speed(NamedTuple):
    """Table 5: execution times on a 200-MHz Pentium Pro [s], and their ratio as printed."""

    title: str
    rows: tuple[str, ...]
    hybrid: tuple[float, ...]
    forward: tuple[float, ...]
    ratio: tuple[float, ...]


_CARS = tuple(f"{m} kg" for m in MASSES)

TABLE_2 = Accuracy("0-100 km/h acceleration times", "s", _CARS, (15.00, 20.00, 25.00), (15.07, 20.12, 25.19), (-0.5, -0.6, -0.8))
TABLE_3 = Accuracy("Energy into the motor on US06", "kWh", _CARS, (2.47, 2.79, 3.06), (2.47, 2.81, 3.12), (0.02, -0.7, -1.9))
TABLE_4 = Accuracy(
    "1936-kg vehicle with zero motor inertia", "s, kWh", ("0-100 km/h (s)", "US06 (kWh)"), (19.76, 2.79), (19.90, 2.81), (-0.7, -0.7)
)
TABLE_5 = Speed("Execution times", ("max. accel.", "FUDS", "HFET"), (16.0, 44.0, 32.0), (28.0, 352.0, 83.0), (1.7, 8.0, 2.6))

#: What the figures show, in our words; the report sets it beside ours.
FIGURES = {
    "2": "The tractive force that the 322-km/h step asks for peaks at about 2.1 MN; the tyres carry a constant 12 kN or so.",
    "3": "Trace, mean required speed, the speed that the tyres' grip allows, and the actual speed, which lies lowest.",
    "5": "The motor is asked for more than its largest torque at all times after 5 s.",
    "6": "After about 42 s the motor would have to turn faster than its top speed.",
    "7": "Between about 9 s and 18 s the map asks for more power than the controller's current limit lets through.",
    "9": "The speeds of the three vehicles by the hybrid method and by iteration can hardly be told apart.",
    "10": "How far the fastest, the mid-speed and the slowest vehicle fall behind US06.",
}
