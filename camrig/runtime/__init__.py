"""The threads and processes of a running rig: workers, mailboxes, planner, control, guardian, daemon."""
