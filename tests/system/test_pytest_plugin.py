"""The fixtures in somebody else's suite: every example of the how-to is run as it stands."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_how_to_examples_pass(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "how-to-test-with-camrig.md").read_text()
    examples = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    for number, example in enumerate(examples):
        (tmp_path / f"test_example_{number}.py").write_text(example)
    pytest = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, f"--rootdir={tmp_path}"]
    done = subprocess.run(
        [*pytest, "-W", "error", str(tmp_path)], cwd=ROOT, capture_output=True, text=True, timeout=100.0, check=False
    )
    assert done.returncode == 0, done.stdout
    assert f"{page.count('def test_')} passed" in done.stdout


def test_the_plugin_imports_nothing_but_pytest() -> None:
    code = "import sys, pytest; import camrig_emulators.pytest_plugin; print([m for m in sys.modules if 'numpy' in m])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30.0, check=True)
    assert done.stdout.strip() == "[]"
