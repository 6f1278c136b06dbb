"""What this computer has plugged in, and whether it is fit to run a rig."""
