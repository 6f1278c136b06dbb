"""The daemon's end of the guardian (see runtime.guardian)."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

from camrig.errors import HardwareError
from camrig.interfaces import Guard

_SCRIPT = Path(__file__).with_name("guardian.py")
_EXIT_TIMEOUT_S = 3.0


class GuardianLink:
    """Starts the guardian process and tells it which ports to stop; used by the head workers' threads."""

    def __init__(self) -> None:
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._process = subprocess.Popen(
                # -I -S: no site, no environment; the guardian needs nothing of ours.
                [sys.executable, "-I", "-S", str(_SCRIPT), str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        finally:
            theirs.close()

    @property
    def pid(self) -> int:
        """The guardian's process."""
        return self._process.pid

    def hold(self, name: str, guard: Guard) -> None:
        """Have the guardian stop this head should the daemon die; raises HardwareError when the guardian is gone."""
        message = b"+" + name.encode() + b"\0" + guard.stop_bytes
        try:
            socket.send_fds(self._channel, [message], [guard.fd])
        except OSError as error:
            raise HardwareError(f"the guardian process is gone ({error}); '{name}' must not be enabled") from error

    def release(self, name: str) -> None:
        """Tell the guardian that this head's port is closed."""
        try:
            self._channel.send(b"-" + name.encode())
        except OSError:
            return  # a dead guardian holds nothing

    def alive(self) -> bool:
        """Return whether the guardian process runs."""
        return self._process.poll() is None

    def close(self) -> None:
        """Let the guardian end; whatever was not released is stopped by it."""
        self._channel.close()
        try:
            self._process.wait(_EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
