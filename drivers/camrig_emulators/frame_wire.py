"""What goes over the Unix socket between a rendered camera and its world; one frame for each ask."""

from __future__ import annotations

import struct

ASK = b"?"
"""Client to world: send me the newest frame that I have not had."""

HEADER = struct.Struct("<dQII")
"""World to client, before width * height bytes of grey: stamp_s, sequence, width, height."""

SCHEME = "unix:"
