"""What is here runs inside the VM only: ``python -m tests.vm`` on the host runs it there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    outside = pytest.mark.skip(reason="needs a kernel of its own: python -m tests.vm runs it in a virtual machine")
    for item in items:
        if HERE in item.path.parents:
            item.add_marker("vm")
            if "CAMRIG_VM" not in os.environ:
                item.add_marker(outside)
