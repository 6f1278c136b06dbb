"""Camera drones over MAVLink 2: ArduCopter in GUIDED, PX4 in OFFBOARD.

``vehicle`` is the logic and knows no socket; ``link`` is the socket and knows no logic; ``drone`` joins the two.
"""

from camrig.interfaces import Driver
from camrig.rig import DroneSpec
from camrig_drivers.mavlink.drone import MavlinkDrone, make
from camrig_drivers.mavlink.section import MavlinkSection, check

driver: Driver[DroneSpec, MavlinkDrone] = Driver(section=MavlinkSection, make=make, check=check)

__all__ = ["MavlinkDrone", "MavlinkSection", "driver"]
