"""What a program in camrig's place may do: tries each thing, and prints the error's name or "allowed", as JSON."""

from __future__ import annotations

import ctypes
import errno
import json
import os
import socket
import sys
from collections.abc import Callable
from functools import partial


def tried(attempt: Callable[[], object]) -> str:
    """Return what came of it."""
    try:
        attempt()
    except OSError as error:
        return errno.errorcode.get(error.errno or 0, str(error))
    return "allowed"


def opened(path: str, flags: int) -> str:
    """Try to open a file or a device."""
    return tried(lambda: os.close(os.open(path, flags | os.O_NONBLOCK)))


def called(name: str, argument: int | bytes) -> str:
    """Try a system call."""

    def attempt() -> None:
        if getattr(ctypes.CDLL(None, use_errno=True), name)(argument) < 0:
            raise OSError(ctypes.get_errno(), name)

    return tried(attempt)


def talk(family: str) -> None:
    """Try a socket."""
    socket.socket(getattr(socket, family), socket.SOCK_DGRAM).close()


def main() -> None:
    """Try everything; the arguments are paths of devices."""
    families = ("AF_UNIX", "AF_INET", "AF_INET6", "AF_NETLINK", "AF_PACKET", "AF_VSOCK")
    places = ("/etc/probe", "/usr/probe", "/opt/camrig/probe", "/var/lib/probe", "/var/lib/camrig/probe")
    found = {
        "uid": str(os.geteuid()),
        **{path: opened(path, os.O_WRONLY | os.O_CREAT) for path in places},
        **{path: opened(path, os.O_RDWR) for path in sys.argv[1:]},
        **{name: tried(partial(talk, name)) for name in families},
        "unshare": called("unshare", 0x10000000),
        "chroot": called("chroot", b"/"),
        "nice": called("nice", 1),
    }
    print(json.dumps(found))


main()
