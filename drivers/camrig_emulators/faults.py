"""What can go wrong with a device: one interface for every emulator.

A test holds the ``Faults`` of a running emulator and sets what it wants, from any thread; the emulator looks at it
whenever it hears or says something. Each device honours what makes sense for it:

    fault            serial line, one head     drone                     rendered camera
    silent           no answers                no telemetry              no frames
    freeze           read-back stands still    telemetry stands still    the same picture again
    latency_s        each answer later         each message later        each frame delivered later
    drop_next        next commands unheard     next commands unheard     next frames missing
    garble           bytes, both directions    bytes, both directions    -
    truncate_reply   answers                   -                         -
    echo             line only                 -                         -
    echo_bytes       first bytes echoed only   -                         -
    echo_delay_s     echo later                -                         -
    stuck            line takes no bytes       -                         -
    swapped          A and B: all is noise     -                         -
    splits           a byte at a time          -                         -
    lose, insert     bytes, both directions    -                         -
    bursts           of FF before answers      -                         -
    unplug, replug   line only                 socket                    device

The fakes in memory raise LinkLost while unplugged and honour ``silent``, ``freeze`` and ``drop_next``. A fault never
touches the truth: a head whose line is unplugged goes on doing what it was last told.
"""

from __future__ import annotations

import random
import threading
from collections.abc import Callable


class Faults:
    """The faults of one device or line; everything may be set from any thread."""

    def __init__(self) -> None:
        self.silent = False
        self.freeze = False
        self.echo = False
        self.stuck = False
        self.swapped = False
        self.splits = False
        self.latency_s = 0.0
        self.echo_bytes: int | None = None
        self.echo_delay_s = 0.0
        self._lock = threading.Lock()
        self._drops = 0
        self._garble_probability = 0.0
        self._lose_probability = self._insert_probability = self._burst_probability = 0.0
        self._cut = (0, 0)
        self._plugged = True
        self._watchers: list[Callable[[], None]] = []

    @property
    def plugged(self) -> bool:
        """Whether the device's port is there at all."""
        return self._plugged

    def unplug(self) -> None:
        """Take the port away, a moment later: whoever has it open finds it dead, whoever opens it finds nothing."""
        self._plug(plugged=False)

    def replug(self) -> None:
        """Bring the port back under its old name, a moment later; what was under way on the line is lost."""
        self._plug(plugged=True)

    def drop_next(self, count: int) -> None:
        """Lose the next ``count`` commands (or frames) before the device hears (or delivers) them."""
        with self._lock:
            self._drops = count

    def garble(self, probability: float) -> None:
        """Flip one bit in each byte on the wire with this probability, 0 to 1."""
        self._garble_probability = _probability(probability)

    def lose(self, probability: float) -> None:
        """Drop each byte on the wire with this probability, 0 to 1."""
        self._lose_probability = _probability(probability)

    def insert(self, probability: float) -> None:
        """Put a random byte before each byte on the wire with this probability, 0 to 1."""
        self._insert_probability = _probability(probability)

    def bursts(self, probability: float) -> None:
        """Put 1 to 9 bytes of FF before an answer with this probability, 0 to 1: a line that floats."""
        self._burst_probability = _probability(probability)

    def truncate_reply(self, last: int, first: int = 0) -> None:
        """Lose the ``last`` bytes of every answer, and its ``first`` ones as a slow line turn-around does; 0 = none."""
        self._cut = (first, last)

    def clear(self) -> None:
        """End every fault."""
        self.silent = self.freeze = self.echo = self.stuck = self.swapped = self.splits = False
        self.latency_s = self.echo_delay_s = 0.0
        self.echo_bytes = None
        self.drop_next(0)
        for spoil in (self.garble, self.lose, self.insert, self.bursts):
            spoil(0.0)
        self.truncate_reply(0)
        self.replug()

    # --- what emulators ask ---------------------------------------------------------------------------------

    def watch(self, changed: Callable[[], None]) -> None:
        """Call ``changed``, in the test's thread, after every ``unplug`` and ``replug``."""
        self._watchers.append(changed)

    def take_drop(self) -> bool:
        """Say whether the command (or frame) at hand is lost, and count it."""
        with self._lock:
            if self._drops <= 0:
                return False
            self._drops -= 1
            return True

    def spoil(self, data: bytes, rng: random.Random) -> bytes:
        """Return the bytes as they arrive over a garbled wire."""
        if self.swapped:
            return rng.randbytes(len(data))
        if not (self._garble_probability or self._lose_probability or self._insert_probability):
            return data
        spoilt = bytearray()
        for byte in data:
            if rng.random() < self._insert_probability:
                spoilt.append(rng.randrange(256))
            if rng.random() >= self._lose_probability:
                spoilt.append(byte ^ (1 << rng.randrange(8)) if rng.random() < self._garble_probability else byte)
        return bytes(spoilt)

    def noise_before(self, rng: random.Random) -> bytes:
        """Return the bytes that a floating line puts before an answer."""
        return b"\xff" * rng.randint(1, 9) if rng.random() < self._burst_probability else b""

    def cut(self, reply: bytes) -> tuple[int, bytes]:
        """Return how many bytes an answer loses at its start, and what is left of it."""
        first, last = self._cut
        return first, reply[first : max(first, len(reply) - last)]

    def _plug(self, *, plugged: bool) -> None:
        self._plugged = plugged
        for changed in self._watchers:
            changed()


def _probability(probability: float) -> float:
    if not 0.0 <= probability <= 1.0:
        raise ValueError(f"a probability is 0 to 1, not {probability}")
    return probability
