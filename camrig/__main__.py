"""``python -m camrig`` is ``camrig``."""

from camrig.cli.main import main

main()
