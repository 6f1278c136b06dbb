"""The emulated MAVLink drone behind its ports: airframe, firmware of two flavours, protocol, telemetry."""
