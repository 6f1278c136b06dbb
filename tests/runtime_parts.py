"""What the tests of the runtime share: a small rig, targets as they are published, and waiting for another thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np

from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.interfaces import Published
from camrig.messages import Event, Target, TargetStatus
from camrig.rig import Body, BodyTag, CameraSpec, HeadMount, HeadSpec, Rig, Space, TagKey

LENS = BrownLens((640, 480), (420.0, 420.0), (320.0, 240.0), (0.0, 0.0, 0.0, 0.0, 0.0))


def until(condition: Callable[[], bool], timeout_s: float = 5.0) -> None:
    """Wait for what another thread or process does; fail when it has not been done within ``timeout_s``."""
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline_s, f"waited for {timeout_s} s"
        time.sleep(0.002)


def nothing(*_: object) -> None:
    """Do nothing."""


def in_a_thread(doing: Callable[[], None]) -> None:
    """Have another thread do something, and wait until it is done."""
    thread = threading.Thread(target=doing)
    thread.start()
    thread.join()


def one_head_rig() -> Rig:
    """Return a floor of 5 x 3 m, one head 2.8 m above its middle, its camera, and three targets."""
    kinematics = PanTilt(transform(np.eye(3), np.array([2.5, 1.5, 2.8])))
    head = HeadSpec("pt1", kinematics, (-2.9, 2.9), (-1.57, 0.0), 0.7, auto_enable=True)
    mount = HeadMount("pt1", transform(R_MOUNT_OPTICAL, np.zeros(3)))
    names = ("robot1", "robot2", "robot3")
    bodies = {name: Body(name, (BodyTag(TagKey("tag36h11", k), 0.2, np.eye(4)),)) for k, name in enumerate(names)}
    return Rig("lab", Space(), {"north": CameraSpec("north", LENS, mount)}, {"pt1": head}, {}, bodies)


def target(
    name: str,
    position_m: tuple[float, float, float] = (1.0, 2.0, 0.1),
    status: TargetStatus = TargetStatus.TRACKED,
    stamp_s: float = 0.0,
) -> Target:
    """Return a target as fusion publishes it: one that was never seen is nowhere, and anywhere."""
    known = status is not TargetStatus.UNSEEN
    return Target(
        id=name,
        stamp_s=stamp_s,
        status=status,
        position_m=np.array(position_m) if known else np.full(3, np.nan),
        velocity_m_s=np.array([0.1, 0.0, 0.0]) if known else np.full(3, np.nan),
        covariance_m2=np.diag(np.full(3, 0.0004 if known else np.inf)),
        R_world_body=np.eye(3),
        seen_by=("north",) if status is TargetStatus.TRACKED else (),
        last_seen_s=stamp_s - 0.05 if known else -np.inf,
        quality_m=0.002 if known else None,
    )


def published(stamp_s: float, *targets: Target, events: tuple[Event, ...] = ()) -> Published:
    """Return one tick's results."""
    return Published(stamp_s, targets, events)
