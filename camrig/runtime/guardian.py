"""The guardian: a minimal child process that stops the heads when the daemon is dead.

A Pelco-D head goes on executing its last command for 15 s and more, so death must be survived from outside. The
daemon starts this file before anything is enabled and passes it, over a Unix socket, a descriptor of every head's port
and the bytes that stop the head. When the daemon's end of the socket closes without a release (SIGKILL, a crash, the
out-of-memory killer), the guardian writes every stop and exits. It imports nothing but the standard library's basics,
so that it starts in milliseconds and cannot fail for want of anything.
"""

import array
import contextlib
import os
import select
import signal
import socket
import sys

REPEATS = 3
REPEAT_GAP_S = 0.06
WRITE_TIMEOUT_S = 0.25


def receive(channel: socket.socket) -> tuple[bytes, int | None]:
    """Return the next message and the descriptor that came with it; empty at the daemon's end."""
    fds = array.array("i")
    message, ancillary, _, _ = channel.recvmsg(4096, socket.CMSG_SPACE(fds.itemsize))
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
            fds.frombytes(data[: fds.itemsize])
    return message, fds[0] if fds else None


def write_stop(fd: int, stop: bytes) -> None:
    """Write the stop bytes; a port that is gone or blocked is left alone."""
    with contextlib.suppress(OSError):
        os.set_blocking(fd, False)  # not earlier: the flag is shared with the daemon's own descriptor
        _, writable, _ = select.select([], [fd], [], WRITE_TIMEOUT_S)
        if writable:
            os.write(fd, stop)


def guard(channel: socket.socket) -> None:
    """Hold what the daemon passes until it goes away, then stop everything that was not released.

    Messages: "+", name, NUL, stop bytes, and a descriptor: hold (or replace); "-", name: release.
    """
    held: dict[bytes, tuple[int, bytes]] = {}
    while True:
        message, fd = receive(channel)
        if not message:
            break
        name, _, stop = message[1:].partition(b"\0")
        if name in held:
            os.close(held.pop(name)[0])
        if message[:1] == b"+" and fd is not None:
            held[name] = (fd, stop)
    for repeat in range(REPEATS):
        if repeat and held:
            select.select([], [], [], REPEAT_GAP_S)
        for fd, stop in held.values():
            write_stop(fd, stop)


if __name__ == "__main__":
    # Sent to the whole service, SIGABRT by its watchdog: the guardian outlives the daemon, and ends by itself.
    for ignored in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT):
        signal.signal(ignored, signal.SIG_IGN)
    guard(socket.socket(fileno=int(sys.argv[1])))
