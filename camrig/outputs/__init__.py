"""Where results go: one sink a module, found by entry point."""
