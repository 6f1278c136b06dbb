"""The Protocols between camrig and its devices. Drivers implement them; camrig never imports a driver.

An entry point (``camrig.cameras``, ``.detectors``, ``.heads``, ``.drones``, ``.sinks``, ``.worlds``) names a
``Driver``: the model of its section of the YAML, and a function that builds its devices from all its sections.

Life cycle of everything here: build (no I/O) -> ``open`` (reads only; never moves anything) -> work -> ``close``
(twice is allowed). Trouble with a link raises ``LinkLost``, after which ``close`` and ``open`` may bring it back.
Unless a docstring says otherwise a device is used by one thread: its worker.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from camrig.geometry.arrays import GreyImage, Transform
from camrig.geometry.lens import Lens
from camrig.messages import (
    AxisReading,
    BodyPose,
    CameraPose,
    DroneHealth,
    DroneReading,
    Event,
    Frame,
    HeadFindings,
    LinkReport,
    RigPlan,
    Sighting,
    TagDetection,
    Target,
)
from camrig.rig import Rig

SpecT = TypeVar("SpecT")
DeviceT = TypeVar("DeviceT")


@dataclass(frozen=True, slots=True)
class Driver(Generic[SpecT, DeviceT]):
    """What an entry point names.

    ``section`` is a pydantic model (frozen, extra keys forbidden) of the keys that the driver adds to those of the
    rig itself. ``make`` gets ``{id: (spec, section)}`` of *all* devices of this driver, so that heads on one bus
    share one port, and returns ``{id: device}``; it opens nothing. ``check`` gets the same and returns
    ``(id, key, message)`` for every fault that no section shows by itself (two heads with one address, pictures of
    another size than the lens). ``discover`` lists what is plugged in, where a driver can; it never moves anything.
    """

    section: type[Any]
    make: Callable[[Mapping[str, tuple[SpecT, Any]]], Mapping[str, DeviceT]]
    check: Callable[[Mapping[str, tuple[SpecT, Any]]], Sequence[tuple[str, str, str]]] | None = None
    discover: Callable[[], Sequence[Found]] | None = None
    tuning: HeadTuning | None = None


@dataclass(frozen=True, slots=True)
class HeadTuning:
    """How a head's driver takes what its calibration found. Sections are the driver's own.

    ``plain`` returns the section of a head to be calibrated: it counts as the file says and reports its motor, without
    play, bend or age. ``changes`` returns what of the section is to be written, by path within the head's own keys.
    ``reads_back`` tells whether a head with that section tells its angles.
    """

    plain: Callable[[Any], Any]
    changes: Callable[[Any, HeadFindings], Mapping[tuple[str, ...], object]]
    reads_back: Callable[[Any], bool] = lambda _: True


@dataclass(frozen=True, slots=True)
class Found:
    """A device, or the port of one, that is plugged in, under the name that lasts longest. ``section`` is what a rig's
    file needs, ``size_px`` what a camera's pictures then have, ``facts`` all else, as it goes into JSON; ``trouble``
    says why it cannot be used now and, after a semicolon, what to do; empty where it can.
    """

    name: str
    title: str
    section: Mapping[str, object]
    size_px: tuple[int, int] | None = None
    facts: Mapping[str, object] = field(default_factory=dict)
    trouble: str = ""


@dataclass(frozen=True, slots=True)
class Plugin(Generic[DeviceT]):
    """What an entry point of ``camrig.detectors``, ``.sinks``, ``.emulators`` or ``.painters`` names: one section, one
    thing.
    """

    section: type[Any]
    make: Callable[[Any], DeviceT]


@dataclass(frozen=True, slots=True)
class WorldPlugin:
    """What an entry point of ``camrig.worlds`` names.

    ``make(rig, section, devices)`` also gets the raw YAML of every camera source, head and drone by id, so that an
    emulated head answers at the address and baud its driver will use.
    """

    section: type[Any]
    make: Callable[[Rig, Any, Mapping[str, Mapping[str, Any]]], World]


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


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """What one control tick publishes."""

    stamp_s: float
    targets: tuple[Target, ...]
    events: tuple[Event, ...] = ()
    links: tuple[LinkReport, ...] = ()
    plan: RigPlan | None = None
    sightings: tuple[Sighting, ...] = ()
    camera_poses: tuple[CameraPose, ...] = ()


class Sink(Protocol):
    """Where results go; called from the control thread, so it must not block."""

    def open(self, rig: Rig) -> None:
        """Open the output; raises InputError where it cannot be written."""
        ...

    def write(self, published: Published) -> None:
        """Take one tick's results."""
        ...

    def close(self) -> None:
        """Flush and release."""
        ...


class World(Protocol):
    """An emulated rig: scenery, robots, and emulated heads and drones on real ports."""

    def start(self) -> Mapping[str, str]:
        """Start everything; return the port or url of each head, drone and camera, by id."""
        ...

    def truth(self, stamp_s: float) -> Mapping[str, Transform]:
        """Return the true ``T_world_body`` of every target at any stamp, by id."""
        ...

    def elapsed_s(self, stamp_s: float) -> float:
        """Return the world's own time at a stamp: two worlds of one seed are alike at the same elapsed time."""
        ...

    def stop(self) -> None:
        """Stop everything, leaving no thread, descriptor or child; twice is allowed."""
        ...


Instant = tuple[Transform, Mapping[str, Transform]]
"""``T_world_camera``, and ``T_world_body`` of every target by id, at one time."""


class Painter(Protocol):
    """Draws what a camera truly sees of a rig's targets, anchors and boxes, off-line. Used by one thread."""

    def paint(self, rig: Rig, lens: Lens, instant_at: Callable[[float], Instant], seed: int) -> GreyImage:
        """Return the raw (height, width) picture through ``lens``, whatever the rig believes of its cameras. Of
        ``instant_at`` seconds within the exposure are asked, 0 in its middle. ``seed`` is of the noise: the same
        arguments give the same picture. Raises InputError for what cannot be drawn.
        """
        ...


class Emulator(Protocol):
    """One emulated device on a real port, as ``camrig emulate`` and other people's tests run it."""

    def start(self) -> str:
        """Start it; return the port or url that the real driver opens."""
        ...

    def describe(self) -> str:
        """Return its state in one line, for a person."""
        ...

    def stop(self) -> None:
        """Stop it, leaving no thread or descriptor; twice is allowed."""
        ...
