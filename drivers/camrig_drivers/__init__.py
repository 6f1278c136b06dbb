"""Device drivers for camrig; found by entry point, never imported by it."""
