"""systemd's notification protocol (sd_notify(3)): readiness, status line and watchdog."""

from __future__ import annotations

import os
import socket
import time


class Notifier:
    """Sends to the socket that systemd names; does nothing where there is none."""

    def __init__(self, address: str | None = None) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "") if address is None else address
        self._address = "\0" + address[1:] if address.startswith("@") else address

    def starting(self, text: str, at_most_s: float) -> None:
        """Say what start-up is busy with, and that it may take so long from now on."""
        self._send(f"STATUS={text}\nEXTEND_TIMEOUT_USEC={round(1e6 * at_most_s)}")

    def ready(self) -> None:
        """Say that start-up is complete."""
        self._send("READY=1")

    def status(self, text: str) -> None:
        """Set the line that ``systemctl status`` shows."""
        self._send(f"STATUS={text}")

    def alive(self) -> None:
        """Feed the watchdog."""
        self._send("WATCHDOG=1")

    def reloading(self) -> None:
        """Say that the configuration is read again; ``ready`` says when that is over, whatever came of it."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000}")

    def stopping(self) -> None:
        """Say that shutdown has begun."""
        self._send("STOPPING=1")

    def _send(self, message: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel:
            channel.setblocking(False)
            try:
                channel.connect(self._address)
                channel.send(message.encode())
            except OSError:
                return  # a supervisor that went away, or does not read, must not hold up the rig
