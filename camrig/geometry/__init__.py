"""Pure geometry: rotations, poses, lenses, pan-tilt kinematics, frustum, PnP. No state, no I/O, no clock."""
