"""An emulated rig: start its world, and fill its ports and urls into the configuration."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from camrig.config.rig_file import RigConfig
from camrig.interfaces import World


@contextmanager
def emulated_world(config: RigConfig) -> Iterator[tuple[RigConfig, World | None]]:
    """Run the configuration's world, if it has one, while inside; yields the configuration to run, and the world."""
    if config.world is None:
        yield config, None
        return
    raw = {name: device.raw for group in config.devices.values() for name, device in group.items()}
    world = config.world.plugin.make(config.rig, config.world.section, raw)
    try:
        yield config.with_ports(world.start()), world
    finally:
        world.stop()
