"""camrig: aims pan-tilt and drone cameras so that all targets together are sensed as well as possible."""
