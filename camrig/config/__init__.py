"""YAML to frozen, checked models to the rig; all the faults of a file at once."""
