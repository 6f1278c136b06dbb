"""Emulated and fake hardware for camrig; shares no code with the drivers it tests."""
