"""A rig of two fake heads, each with a fake camera, and what its daemon did."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from camrig.config.rig_file import RigConfig, load_rig
from camrig.interfaces import Published
from camrig.rig import Rig
from camrig.runtime.daemon import Daemon
from camrig_emulators.fakes import FakeHead
from tests.runtime_parts import nothing

RIG = """\
rig: fakes
space: {floor_m: [[0, 0], [5, 3]]}
lenses:
  lab: {size_px: [320, 240], fx: 400, fy: 400, cx: 160, cy: 120}
cameras:
  - {id: north, lens: lab, source: {driver: fake, fps: 10}, mount: {head: pt1}}
  - {id: south, lens: lab, source: {driver: fake, fps: 10}, mount: {head: pt2}}
heads:
  - {id: pt1, driver: fake, enable: auto, position_m: [1, 1.5, 2.8], tilt_deg: [-90, 0]}
  - {id: pt2, driver: fake, enable: auto, position_m: [4, 1.5, 2.8], tilt_deg: [-90, 0]}
targets:
  - {id: robot1, tags: [{id: 1, size_m: 0.2}]}
"""


@dataclass
class Log:
    """A sink that keeps what it is given, and does what a test wants done as it is opened, written to and closed."""

    opening: Callable[[Rig], None] = nothing
    each: Callable[[Published], None] = nothing
    closing: Callable[[], None] = nothing
    published: list[Published] = field(default_factory=list)
    closed_s: float | None = None

    def open(self, rig: Rig) -> None:
        self.opening(rig)

    def write(self, published: Published) -> None:
        self.published.append(published)
        self.each(published)

    def close(self) -> None:
        self.closed_s = time.monotonic()
        self.closing()

    def said(self) -> list[str]:
        return [f"{event.about}: {event.text}" for published in self.published for event in published.events]


def load(folder: Path, text: str = RIG) -> RigConfig:
    """Write a rig's file and read it."""
    path = folder / "rig.yaml"
    path.write_text(text)
    return load_rig(path)


def head(daemon: Daemon, name: str) -> FakeHead:
    found = daemon.devices.heads[name].head
    assert isinstance(found, FakeHead)
    return found


def log(daemon: Daemon) -> Log:
    (found,) = daemon.extra_sinks
    assert isinstance(found, Log)
    return found


def has_moved(daemon: Daemon, name: str) -> bool:
    return any(aim is not None for _, aim in head(daemon, name).commands)


def supervising(daemon: Daemon) -> threading.Thread:
    """Supervise in a thread, as the main one does."""
    thread = threading.Thread(target=daemon.supervise)
    thread.start()
    return thread


def at_rest(daemon: Daemon) -> bool:
    """Tell whether a stop was the last that both heads were told."""
    fakes = [head(daemon, name) for name in ("pt1", "pt2")]
    return all(not fake.enabled and fake.commands[-1][1] is None for fake in fakes)
