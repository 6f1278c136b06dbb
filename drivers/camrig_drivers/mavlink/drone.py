"""A camera drone on a MAVLink link: the ``Drone`` of camrig.interfaces around a ``Vehicle``.

The thread that calls ``read`` does all the work; ``arm``, ``go_to``, ``stop`` and ``land`` check what can be checked,
leave an order for it and wake it.

After ``stop`` or a fault the drone holds where it is and refuses ``go_to`` until ``resume``. ``stop`` while it takes
off holds it there (on the ground: ends the take-off), while it lands by our order it breaks the landing off, and where
somebody else flies it (a pilot, a failsafe) it changes nothing. ``close`` leaves a flying drone standing in the air and
lets a landing go on; it never lands or disarms.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping

from camrig.clock import Clock, RealClock
from camrig.errors import HardwareError, InputError, LinkLost, NotEnabledError
from camrig.messages import BodyPose, DroneHealth, DroneReading
from camrig.rig import DroneSpec
from camrig_drivers.mavlink.box import box_text, inside
from camrig_drivers.mavlink.codec import Address
from camrig_drivers.mavlink.fitness import advice, unfit
from camrig_drivers.mavlink.flavours import FLAVOURS
from camrig_drivers.mavlink.frames import Vector
from camrig_drivers.mavlink.link import Link
from camrig_drivers.mavlink.packets import Heard, Heartbeat, Odometry, Said, VisionEstimate
from camrig_drivers.mavlink.phase import Phase
from camrig_drivers.mavlink.section import MavlinkSection
from camrig_drivers.mavlink.signing import Signing
from camrig_drivers.mavlink.telemetry import LINK_SILENCE_S, Telemetry
from camrig_drivers.mavlink.vehicle import Vehicle
from camrig_drivers.mavlink.vision import VisionPoses
from camrig_drivers.mavlink.watch import STALE_S

_log = logging.getLogger(__name__)

_OPEN_TIMEOUT_S = 5.0
_RELEASE_TIMEOUT_S = 1.5

Order = Callable[[Vehicle, float], None]


class MavlinkDrone:
    """One drone. ``read`` and ``close`` belong to its worker thread, the orders to any thread."""

    def __init__(self, spec: DroneSpec, section: MavlinkSection, link: Link, clock: Clock | None = None) -> None:
        self.key: Address = (section.system, section.component)
        self._spec = spec
        self._section = section
        self._link = link
        self._clock = clock or RealClock()
        self._vehicle: Vehicle | None = None
        self._orders: deque[Order] = deque(maxlen=32)
        self._poses: deque[BodyPose] = deque(maxlen=4)
        self._vision: VisionPoses | None = None
        self._stopped = self._releasing = False
        self._intruder = ""
        self._unflyable = ""

    # --- Drone ------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Wait for the autopilot's heartbeat and ask for its streams; commands nothing that moves.

        Raises LinkLost without a heartbeat, HardwareError for an autopilot we do not know.
        """
        self.close()
        self._orders.clear()
        self._stopped, self._intruder, self._unflyable = False, "", ""
        self._link.join(self)
        try:
            self._link.serve(_OPEN_TIMEOUT_S, lambda: self._vehicle is not None or bool(self._unflyable))
            self._check_opened()
        except BaseException:
            self._link.leave(self)
            raise

    def read(self, timeout_s: float) -> tuple[DroneReading, ...]:
        vehicle = self._opened()
        self._link.serve(timeout_s, lambda: bool(vehicle.report.readings))
        if vehicle.seen.silent(self._clock.now_s()):
            raise LinkLost(f"drone {self._spec.id}: no heartbeat for {LINK_SILENCE_S:g} s on {self._link.url}")
        if self._intruder and vehicle.phase is Phase.PASSIVE:
            raise LinkLost(self._intruder)
        readings = []
        with contextlib.suppress(IndexError):
            while True:
                readings.append(vehicle.report.readings.popleft())
        return tuple(readings)

    def arm(self) -> None:
        vehicle = self._opened()
        flies = "it is in the air; resume it, and it follows plans from where it is" if vehicle.seen.airborne else ""
        self._refuse("armed", flies)
        self._stopped = False
        self._order(Vehicle.arm)

    def resume(self) -> None:
        vehicle = self._opened()
        self._refuse("resumed", "" if vehicle.seen.airborne else "it is not in the air; arm it, and it takes off")
        self._stopped = False
        self._order(Vehicle.resume)

    def _refuse(self, what: str, first: str) -> None:
        reasons = (first,) if first else self._unfit()
        if reasons:
            raise HardwareError(f"drone {self._spec.id} is not {what}: {'; '.join(reasons)}")

    def _unfit(self) -> tuple[str, ...]:
        if self._intruder:
            return (self._intruder,)
        vehicle = self._opened()
        return tuple(unfit(vehicle, self._clock.now_s()))

    def go_to(self, position_m: Vector, yaw_rad: float) -> None:
        if not inside(position_m, self._spec.box_m) or not math.isfinite(yaw_rad):
            asked = ", ".join(f"{value:g}" for value in position_m)
            box = box_text(self._spec.box_m)
            raise InputError(f"drone {self._spec.id}: ({asked}) m, yaw {yaw_rad:g} rad is outside its box {box}")
        vehicle = self._vehicle
        if vehicle is None or self._stopped or vehicle.phase is not Phase.FLYING:
            reason = f" ({vehicle.reason})" if vehicle is not None and vehicle.reason else ""
            raise NotEnabledError(
                f"drone {self._spec.id} is not flying under our command{reason}; arm or resume it first"
            )
        self._order(lambda vehicle, _now_s: vehicle.go_to(position_m, yaw_rad))

    def stop(self) -> None:
        self._stopped = True
        self._orders.clear()
        self._orders.append(Vehicle.stop)
        with contextlib.suppress(LinkLost):
            self._link.serve_now()

    def land(self) -> None:
        self._opened()
        self._order(Vehicle.land)

    def close(self) -> None:
        vehicle = self._vehicle
        if vehicle is not None and not vehicle.seen.silent(self._clock.now_s()):
            self._releasing = True
            with contextlib.suppress(LinkLost):
                self._link.serve_now()
                self._link.serve(_RELEASE_TIMEOUT_S, lambda: self._released(vehicle))
        self._link.leave(self)
        self._vehicle, self._releasing = None, False

    def take_pose(self, pose: BodyPose) -> None:
        if self._vision is not None:
            self._poses.append(pose)
            self._link.wake()

    def health(self) -> DroneHealth | None:
        vehicle, now_s = self._vehicle, self._clock.now_s()
        if vehicle is None:
            return None
        seen = vehicle.seen
        return DroneHealth(
            activity=vehicle.phase.name.lower(),
            obeys=vehicle.phase is Phase.FLYING and not self._stopped,
            begins=vehicle.phase in {Phase.ENTERING, Phase.ARMING, Phase.CLIMBING},
            lands=vehicle.phase in {Phase.LANDING, Phase.DESCENDING},
            reason=vehicle.reason,
            unfit=self._unfit(),
            advice=tuple(advice(vehicle)),
            battery=seen.system.battery if seen.system else None,
            pose_age_s=None if seen.position_m is None else now_s - seen.position_s,
            software=f"{vehicle.flavour.name} {seen.version.number}" if seen.version else vehicle.flavour.name,
        )

    # --- Station: called by the thread that serves the link ---------------------------------------------

    def hear(self, packet: Heard, now_s: float) -> None:
        if isinstance(packet, Heartbeat) and not self._meet(packet, now_s):
            return
        if self._vehicle is not None:
            self._vehicle.hear(packet, now_s)

    @property
    def may_fly(self) -> bool:
        vehicle = self._vehicle
        if vehicle is None:
            return False
        commanded = vehicle.phase is not Phase.PASSIVE
        return commanded or vehicle.seen.airborne or vehicle.seen.heartbeat.armed

    def intrude(self, what: str) -> None:
        """Refuse to go on, unless it flies: then its set-points go on to the address that it has always had."""
        first = not self._intruder
        self._intruder = (
            f"drone {self._spec.id}: two autopilots speak as system {self.key[0]} on {self._link.url} ({what}): "
            "give each its own system id"
        )
        if first:
            _log.warning("%s", self._intruder)

    def speak(self, now_s: float) -> Iterable[Said]:
        vehicle = self._vehicle
        if vehicle is None:
            return ()
        with contextlib.suppress(IndexError):
            while True:
                self._orders.popleft()(vehicle, now_s)
        if self._releasing:  # after all orders, whichever stop has come between
            self._releasing = False
            vehicle.release(now_s)
        return [*self._due_poses(vehicle, now_s), *vehicle.tick(now_s)]

    def _due_poses(self, vehicle: Vehicle, now_s: float) -> Iterator[Said]:
        """Yield the newest pose from outside; none that has waited while the link was blocked."""
        if not self._poses or self._vision is None:
            return
        newest = self._poses.pop()
        self._poses.clear()
        pose = self._vision.take(newest) if now_s - newest.stamp_s < STALE_S else None
        if pose is not None:
            x, y, z = newest.T_world_body[:3, 3].tolist()
            vehicle.watch.see_from_outside((x, y, z), newest.stamp_s)
            yield Odometry(pose) if vehicle.flavour.takes_odometry else VisionEstimate(pose)

    def due_s(self, now_s: float) -> float:
        return self._vehicle.due_s(now_s) if self._vehicle else math.inf

    # --- inside -----------------------------------------------------------------------------------------

    def _meet(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """Learn from the first heartbeat which autopilot it is; return whether this one is of that autopilot."""
        if not heartbeat.is_autopilot:
            return False
        flavour = FLAVOURS.get(heartbeat.autopilot)
        if self._vehicle is None and flavour is None:
            self._unflyable = f"is autopilot type {heartbeat.autopilot}; ArduPilot (3) and PX4 (12) can be flown"
        elif self._vehicle is None and not heartbeat.is_copter:
            self._unflyable = f"is a vehicle of MAV_TYPE {heartbeat.kind}; multicopters can be flown"
        elif self._vehicle is None and flavour is not None:
            seen = Telemetry(self._spec.id, self._section.origin_m, heartbeat, now_s)
            settings = self._section.settings(sets_origin=flavour.wants_origin)
            self._vision = VisionPoses(seen.frame) if settings.needs.vision else None
            self._poses.clear()
            self._vehicle = Vehicle(self._spec, flavour, seen, settings)
        elif self._vehicle is not None and flavour is not self._vehicle.flavour:
            self.intrude(f"autopilot types {self._vehicle.flavour.autopilot} and {heartbeat.autopilot}")
            return False
        return True

    def _check_opened(self) -> None:
        if self._vehicle is not None:
            return
        system, component = self.key
        if self._unflyable:
            raise HardwareError(f"drone {self._spec.id}: system {system} {self._unflyable}")
        refused = f"; {self._link.refused} frames were not signed with its key" if self._link.refused else ""
        if self._intruder:
            raise LinkLost(self._intruder)
        others = ", ".join(f"{a} component {b}" for a, b in self._link.strangers()) or "none"
        raise LinkLost(
            f"drone {self._spec.id}: no heartbeat of system {system} component {component} on {self._link.url} "
            f"within {_OPEN_TIMEOUT_S:g} s; other autopilots heard: {others}{refused}"
        )

    def _opened(self) -> Vehicle:
        if self._vehicle is None:
            raise LinkLost(f"drone {self._spec.id} is not open")
        return self._vehicle

    def _released(self, vehicle: Vehicle) -> bool:
        gone = vehicle.seen.silent(self._clock.now_s())
        return gone or (not self._orders and not self._releasing and vehicle.phase is not Phase.BRAKING)

    def _order(self, order: Order) -> None:
        self._orders.append(order)
        self._link.wake()


def make(drones: Mapping[str, tuple[DroneSpec, MavlinkSection]]) -> dict[str, MavlinkDrone]:
    """Build all drones; those with one url share a link. Opens nothing."""
    links = {section.url: Link(section.url, RealClock(), _signing(section)) for _, section in drones.values()}
    return {name: MavlinkDrone(spec, section, links[section.url]) for name, (spec, section) in drones.items()}


def _signing(section: MavlinkSection) -> Signing | None:
    return Signing(section.signing.key_file, section.signing.link) if section.signing else None
