"""A pseudo-terminal behind a name that stays: how a serial emulator meets a real driver.

One thread a line, which blocks until the driver writes, an answer is due, or the port is unplugged. The name is a
symbolic link in a folder of its own, as /dev/serial/by-id is: unplugging removes it and hangs the terminal up
(readers get EIO), replugging puts a new terminal behind it.
"""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import tempfile
import termios
import threading
import tty
from pathlib import Path
from typing import Protocol

from camrig.clock import Clock
from camrig_emulators.faults import Faults

_OUTPUT_SPEED = 5
_SPEEDS = {baud: getattr(termios, f"B{baud}") for baud in (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400)}
_BAUDS = {speed: baud for baud, speed in _SPEEDS.items()}


class SerialDevice(Protocol):
    """What sits at the far end of the line; called by the line's thread."""

    baud: int

    def receive(self, data: bytes, now_s: float, baud: int) -> None:
        """Take what the driver wrote at ``now_s`` through a port set to ``baud``."""
        ...

    def transmit(self, now_s: float, baud: int) -> bytes:
        """Return what has arrived at a port set to ``baud`` since the last call."""
        ...

    def next_s(self) -> float | None:
        """Return when ``transmit`` should be called next; None for not before the driver writes."""
        ...

    def cut(self) -> None:
        """Lose what is under way."""
        ...


class _Terminal:
    """The two ends of one pseudo-terminal; ours of the driver's end keeps it alive while no driver has it open."""

    def __init__(self, baud: int) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        modes = termios.tcgetattr(self._slave)
        modes[4:6] = [_SPEEDS[baud], _SPEEDS[baud]]
        termios.tcsetattr(self._slave, termios.TCSANOW, modes)
        os.set_blocking(self.master, False)
        self.path = os.ttyname(self._slave)

    def baud(self) -> int:
        """Return the rate that the driver has set, 0 for one we do not know."""
        return _BAUDS.get(termios.tcgetattr(self._slave)[_OUTPUT_SPEED], 0)

    def read(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return os.read(self.master, 4096)
        return b""

    def write(self, data: bytes) -> None:
        """Deliver bytes; they are lost where nobody reads and the terminal's buffer is full."""
        with contextlib.suppress(BlockingIOError):
            os.write(self.master, data)

    def close(self) -> None:
        os.close(self._slave)
        os.close(self.master)


class PtyLine:
    """Runs a ``SerialDevice`` on a pseudo-terminal."""

    def __init__(self, name: str, device: SerialDevice, *, clock: Clock, faults: Faults) -> None:
        self._name = name
        self._device = device
        self._clock = clock
        self._faults = faults
        self._folder: Path | None = None
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._wake_lock = threading.Lock()
        self._wake_read = self._wake_write = -1
        faults.watch(self._wake)

    @property
    def path(self) -> str:
        """The name under which the driver finds the line, the same over a replug."""
        if self._folder is None:
            raise RuntimeError(f"the emulated line {self._name} has no port before it is started")
        return str(self._folder / self._name)

    def start(self) -> None:
        """Open the terminal and start its thread; twice is allowed."""
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="camrig-"))
            self._wake_read, self._wake_write = os.pipe()
            os.set_blocking(self._wake_write, False)
            self._stopping.clear()
            terminal = self._plug(self._folder)
            self._thread = threading.Thread(target=self._serve, args=(self._folder, terminal), name=self._name)
            self._thread.start()

    def stop(self) -> None:
        """End the thread and remove the terminal and its name; twice is allowed."""
        if self._folder is None or self._thread is None:
            return
        self._stopping.set()
        self._wake()
        self._thread.join()
        with self._wake_lock:
            os.close(self._wake_write)
            os.close(self._wake_read)
            self._wake_read = self._wake_write = -1
        shutil.rmtree(self._folder)
        self._folder = self._thread = None

    def _wake(self) -> None:
        with self._wake_lock, contextlib.suppress(BlockingIOError):
            if self._wake_write >= 0:
                os.write(self._wake_write, b"!")

    def _plug(self, folder: Path) -> _Terminal:
        terminal = _Terminal(self._device.baud)
        (folder / self._name).symlink_to(terminal.path)
        return terminal

    def _unplug(self, folder: Path, terminal: _Terminal) -> None:
        (folder / self._name).unlink()
        terminal.close()
        self._device.cut()

    def _serve(self, folder: Path, terminal: _Terminal | None) -> None:
        while not self._stopping.is_set():
            if terminal is not None and not self._faults.plugged:
                self._unplug(folder, terminal)
                terminal = None
            elif terminal is None and self._faults.plugged:
                terminal = self._plug(folder)
            self._exchange(terminal)
        if terminal is not None:
            terminal.close()

    def _exchange(self, terminal: _Terminal | None) -> None:
        """Wait for the next thing to happen, and let it."""
        ports = [self._wake_read] if terminal is None else [self._wake_read, terminal.master]
        readable, _, _ = select.select(ports, [], [], self._patience_s())
        if self._wake_read in readable:
            os.read(self._wake_read, 64)
        if terminal is None:
            return
        now_s, baud = self._clock.now_s(), terminal.baud()
        if terminal.master in readable:
            self._device.receive(terminal.read(), now_s, baud)
        if data := self._device.transmit(now_s, baud):
            terminal.write(data)

    def _patience_s(self) -> float | None:
        next_s = self._device.next_s()
        return None if next_s is None else max(0.0, next_s - self._clock.now_s())
