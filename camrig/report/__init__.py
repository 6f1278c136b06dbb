"""Pictures and reports of what a rig did."""
