"""Cameras, detectors, heads and drones, and what some of them can besides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from camrig.geometry.arrays import GreyImage
from camrig.messages import AxisReading, BodyPose, DroneHealth, DroneReading, Frame, TagDetection


class Camera(Protocol):
    """A source of grey frames."""

    def open(self) -> None:
        """Open and start streaming; raises LinkLost, or HardwareError where the device is not what was asked."""
        ...

    def read(self, timeout_s: float) -> Frame | None:
        """Block up to ``timeout_s`` for the newest frame; None on time-out or ``wake``. Raises LinkLost, and
        EndOfInput once the input has ended for good. The image stays valid until the next call.
        """
        ...

    def wake(self) -> None:
        """Make a blocked ``read`` return None at once; any thread."""
        ...

    def close(self) -> None:
        """Stop streaming and release the device."""
        ...


class TagDetector(Protocol):
    """Finds tags in one grey picture. One instance a thread, kept for the life of the process."""

    def detect(self, image: GreyImage) -> tuple[TagDetection, ...]:
        """Find all tags in a raw (height, width) picture; corners in OpenCV's pixel convention. Releases the GIL.
        Raises InputError on a picture with a side under 16 px.
        """
        ...


@runtime_checkable
class SearchesCoarser(Protocol):
    """What a detector's driver offers besides, where it can look for one picture's tags coarser than for the next's."""

    def detect_shrunk(self, image: GreyImage, decimate: float) -> tuple[TagDetection, ...]:
        """Find all tags as ``detect`` does, with the search for squares in a picture shrunk by ``decimate`` (2, 3 or 4)
        instead of what is configured.
        """
        ...


class Actuator(Protocol):
    """What heads and drones have in common."""

    def open(self) -> None:
        """Open the link and read; never moves anything. Raises LinkLost."""
        ...

    def stop(self) -> None:
        """End all motion now, in any state, from any thread, ahead of every queue, and disable: nothing moves again
        before a new ``enable``. A head writes stop to the wire, a drone holds where it is. Never blocks for more
        than one exchange in flight; a lost link is not an error here.
        """
        ...

    def close(self) -> None:
        """Stop if enabled, then release the link; twice is allowed."""
        ...


@dataclass(frozen=True, slots=True)
class Guard:
    """What the guardian process needs to stop a head when the daemon is dead: a descriptor and the bytes.

    No bytes where nothing could stop it from outside: a head that takes positions alone, and comes to rest by itself.
    """

    fd: int
    stop_bytes: bytes


class Head(Actuator, Protocol):
    """A pan-tilt head. Angles as in docs/frames-and-units.md; the driver converts to what the device wants."""

    def enable(self) -> None:
        """Allow motion; commands nothing."""
        ...

    def move_to(self, pan_rad: float, tilt_rad: float) -> None:
        """Send both axes to a position and return without waiting for it. Raises NotEnabledError, LinkLost, and
        InputError outside the head's limits.
        """
        ...

    def read(self, timeout_s: float) -> tuple[AxisReading, ...]:
        """Poll the position once; blocks for the exchange, at most about ``timeout_s``. Empty where the head did not
        answer; raises LinkLost when the link is gone.
        """
        ...

    def guard(self) -> Guard:
        """Return what stops this head from outside; valid from ``open`` until the link is lost or closed."""
        ...


@runtime_checkable
class CountsItsLink(Protocol):
    """What a driver offers besides, where it counts what passes over a device's link; any thread."""

    def statistics(self) -> Mapping[str, float]:
        """Return counts since the link was opened, and times whose keys end in ``_s``."""
        ...


@runtime_checkable
class LearnsItsAngles(Protocol):
    """What a head's driver offers besides, where the head reports nothing, or not enough."""

    def correct(self, reading: AxisReading) -> None:
        """Take an angle that something else measured, as anchors in the picture do; by the thread that reads."""
        ...


@runtime_checkable
class TurnsByStep(Protocol):
    """What a head's driver offers besides, where the head can be turned at speeds that have a number each."""

    def steps(self) -> Mapping[str, Sequence[int]]:
        """Return the steps of speed of "pan" and "tilt", slowest first, 1 and up."""
        ...

    def turn(self, pan: int, tilt: int) -> float:
        """Turn at signed steps, positive towards growing angles, until told otherwise; 0 stands. Any ``move_to`` ends.
        Returns when the head will have heard it; raises as ``move_to`` does. Limits are the caller's care.
        """
        ...


class Drone(Actuator, Protocol):
    """A camera drone. Positions are world metres (ENU), yaw 0 = nose along world x, counter-clockwise."""

    def arm(self) -> None:
        """Operator's order on the ground: arm and climb to the box's lowest height; HardwareError says why not."""
        ...

    def resume(self) -> None:
        """Operator's order in the air: take hover points again, from where it is. As ``arm``, refused on the ground."""
        ...

    def go_to(self, position_m: tuple[float, float, float], yaw_rad: float) -> None:
        """Set the hover point; raises NotEnabledError unless flying under our command, InputError outside the box."""
        ...

    def land(self) -> None:
        """Operator's order: land here; non-blocking, any state."""
        ...

    def read(self, timeout_s: float) -> tuple[DroneReading, ...]:
        """Serve the link (heartbeat, set-points, acks) for up to ``timeout_s`` and return new readings, oldest first.
        Raises LinkLost after a silence of 3 s.
        """
        ...


@runtime_checkable
class TellsItsHealth(Protocol):
    """What a drone's driver offers besides, where it knows more than the pose."""

    def health(self) -> DroneHealth | None:
        """Return how the drone is, None while it is not open; any thread."""
        ...


@runtime_checkable
class FliesByPoses(Protocol):
    """What a drone's driver offers besides, where the drone may navigate by what its camera sees."""

    def take_pose(self, pose: BodyPose) -> None:
        """Send a pose to the autopilot at once, where it wants any; any thread."""
        ...
